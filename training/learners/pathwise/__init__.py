"""Training by the exact gradient of flights, backwards through the twin's equations."""
