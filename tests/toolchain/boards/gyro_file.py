"""A file like the one that the maker of a BMI270 publishes, with bytes of our own."""

from __future__ import annotations

CONFIGURATION = bytes.fromhex("c82e002e") + bytes(range(4, 168)) + bytes(range(160))
C_FILE = (
    '/* The array that counts is not { 0x01 }. */\n#include "chip.h"\n'
    "const uint8_t configuration[] = {  // bytes\n    "
    + ", ".join(f"0x{byte:02x}" for byte in CONFIGURATION)
    + "\n};\nconst struct feature features[MAX] = {\n\n};\nint use(void) { return 1; }\n"
)
