"""The eigenscan command."""
