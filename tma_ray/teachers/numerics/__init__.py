"""The numerics of teachers: densities, mixtures, networks, regions, learning progress."""
