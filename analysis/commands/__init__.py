"""Commands that read results: each writes files or prints to the terminal."""
