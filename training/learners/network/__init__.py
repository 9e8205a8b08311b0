"""Networks in C, of all learners that are in C."""
