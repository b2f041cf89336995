"""The arm and its signals in Rerun, live and recorded."""
