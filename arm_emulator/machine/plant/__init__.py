"""One machine in its compiled library: state, inputs, outputs."""
