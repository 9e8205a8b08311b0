"""Cards for logs: empty files in a FAT32 file system, which a firmware fills and a computer reads."""
