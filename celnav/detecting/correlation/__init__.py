"""What all stars of an image have in common, told by the image's correlation with itself before any star is found."""
