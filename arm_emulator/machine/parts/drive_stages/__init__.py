"""Parts around a motor: loops, inverter, winding, ripple."""
