"""The playground: Stump Tracks and Parkour on a page, with the kernels of the engine as WebAssembly."""
