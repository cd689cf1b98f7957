"""Playground: Stump Tracks and Parkour on a page, with the engine's kernels as WebAssembly."""
