"""Learners of many runs at once, stacked along a leading axis; on a GPU, mostly."""
