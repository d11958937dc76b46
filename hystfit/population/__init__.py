"""Populations: how much devices of one kind differ, and what the next one will do."""
