"""Settings by name, as text and as files, and the rules that they keep together."""
