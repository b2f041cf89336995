"""Physics of the machine against other simulators, published figures and what scenes leave out."""
