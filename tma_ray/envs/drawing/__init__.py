"""Drawing of frames: scene, camera and colours."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # before the package's modules import pygame
