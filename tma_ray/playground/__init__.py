"""Playground: a web page with Stump Tracks and Parkour that runs the engine's kernels as WebAssembly."""
