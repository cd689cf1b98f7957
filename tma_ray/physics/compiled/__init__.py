"""The compiled engine: Chipmunk's C functions, called from compiled code."""
