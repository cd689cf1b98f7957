"""Campaigns that repeat what was released, for other teachers."""
