"""Live play of a policy: its world, sliders that choose the task, a window or a video."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # before the package's modules import pygame
