"""The friction laws, one module each."""
