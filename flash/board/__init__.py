"""Identity and state of a firmware, and requests to it: restart, calibrate, acknowledge."""
