"""Robot descriptions as text: joints, couplings, shafts, limits."""
