"""Teachers that replay tasks by a score of the episode, as unsupervised environment design does."""
