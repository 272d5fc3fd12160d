"""Files: bytes to columns, rows and folders, and back."""
