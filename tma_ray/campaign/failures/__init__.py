"""Answers to failures: retries, storage outages, requests to stop."""
