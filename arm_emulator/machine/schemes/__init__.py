"""The schemes that integrate a machine, a file each; see `scheme.py`."""
