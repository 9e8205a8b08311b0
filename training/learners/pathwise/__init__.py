"""Synthesis by the exact gradient of what was flown, backwards through the twin's equations."""
