"""Pictures, films and a live view of a running world."""
