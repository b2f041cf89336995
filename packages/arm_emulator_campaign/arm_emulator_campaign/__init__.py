"""Many runs of one scenario: what varies, faults, requirements, search."""
