"""Work of a learner that it does not wait for: weights on their way, and files."""
