"""Laws of friction, and the brake."""
