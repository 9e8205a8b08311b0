"""What commands are tested with: the policies of the compiler's tests."""

from tests.flash.conftest import free_tcp_port as free_tcp_port
from tests.flash.conftest import tcp_server as tcp_server
from tests.toolchain.conftest import kit as kit
