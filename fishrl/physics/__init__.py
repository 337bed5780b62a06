"""The flow and the fish in it: batched immersed-boundary lattice Boltzmann in torch."""
