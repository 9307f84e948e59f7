"""The gallery: pictures and plots for people (docs/gallery). Needs the extra ``dev`` (colour-science, matplotlib)."""
