"""The hold on a results root: the lease of its campaign, and the heartbeat that shows it alive."""
