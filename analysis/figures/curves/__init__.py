"""Learning curves of pooled runs, with stars where teachers or levels of expert knowledge differ."""
