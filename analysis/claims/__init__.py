"""The paper's claims, held against results."""
