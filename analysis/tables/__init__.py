"""The paper's tables, from results of runs and from published ones."""
