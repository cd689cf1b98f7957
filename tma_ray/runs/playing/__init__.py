"""The playing of episodes: tests, trials without learning, and the recording of steps."""
