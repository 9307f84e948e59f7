"""Images from files: FITS, HEIF, PNG, TIFF and JPEG, as arrays, with what the files say about the exposure."""
