"""What a frame is drawn with: what it shows, from where, and in which colours."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # before the package's modules import pygame
