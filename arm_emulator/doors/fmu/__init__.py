"""The machine as a functional mock-up unit, for simulators that speak FMI."""
