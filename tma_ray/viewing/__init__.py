"""Viewing of policies: rendered episodes, and a live window with sliders."""
