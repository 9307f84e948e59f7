"""The gallery: pictures and plots of docs/gallery. Needs the extra ``dev`` (matplotlib)."""
