"""Runs of a campaign: what decides each, its simulation and its outcome."""
