"""What others' files are read with: JSON, frame records, tables and images, each within stated limits."""
