"""Students of stable-baselines3's and sb3-contrib's algorithms. Importing this package imports no torch."""
