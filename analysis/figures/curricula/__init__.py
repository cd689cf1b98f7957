"""Figures of curricula: training tasks, film strips of the task distribution, dimensions, teachers' logs."""
