"""Messages by type and by bytes, in Python and C."""
