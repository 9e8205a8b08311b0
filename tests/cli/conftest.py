"""What commands are tested with: the policies of the compiler's tests."""

from tests.toolchain.conftest import kit as kit
