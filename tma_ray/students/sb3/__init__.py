"""Students on top of stable-baselines3 and sb3-contrib, importable without torch."""
