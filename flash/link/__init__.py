"""MSP over a line: codec and payloads without I/O, transports, a client."""
