"""Radar charts: results on all challenges as ratios of Random."""
