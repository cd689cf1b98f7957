"""The paper's tables, from results of runs or from published results."""
