"""Colours of what is drawn, as red, green and blue up to 255."""

from __future__ import annotations

Colour = tuple[int, int, int]

SKY_TOP, SKY_BOTTOM = (150, 190, 225), (236, 243, 247)
SOIL, SOIL_EDGE, MARK = (104, 122, 92), (66, 84, 60), (142, 158, 130)
ROCK, ROCK_EDGE = (124, 118, 110), (78, 74, 70)
CREEPER, CREEPER_EDGE = (96, 158, 84), (52, 100, 50)
WATER, WATER_EDGE = (70, 150, 205), (44, 112, 172)

HEAD, LIMB, FAR_LIMB, OUTLINE = (86, 98, 178), (126, 138, 212), (104, 110, 150), (42, 48, 96)
DEAD_HEAD, DEAD_LIMB, DEAD_FAR_LIMB, DEAD_OUTLINE = (128,) * 3, (166,) * 3, (142,) * 3, (70,) * 3
GRIP_FREE, GRIP_TOUCHING, GRIP_HOLDING = (246, 208, 52), (242, 138, 40), (210, 40, 36)

LIDAR, LIDAR_WATER, LIDAR_CREEPER = (214, 74, 62), (28, 92, 190), (34, 120, 44)
GOAL, TRACK = (216, 66, 50), (120, 140, 158)
