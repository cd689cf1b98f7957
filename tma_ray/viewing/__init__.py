"""Policies seen at work: rendered episodes, and a live window with sliders."""
