"""Campaigns: many runs of one scenario, what varies among them, what must hold in each."""
