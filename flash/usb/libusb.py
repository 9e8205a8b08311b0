"""USB devices of this computer, by pyusb over the system's libusb."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from neuroflight.flash.link.transport import LineGoneError
from neuroflight.flash.usb.control import StalledError
from neuroflight.flash.usb.rules import INSTALL
from neuroflight.toolchain.errors import LinkError

if TYPE_CHECKING:
    import usb.core

INTERFACE = 0
ALTERNATES_MAX = 16  # that a device may have
_CLASS_READ, _CLASS_WRITE = 0xA1, 0x21  # requests of a class, to an interface
_LIBUSB = {
    "win32": "pip install libusb-package",
    "darwin": "brew install libusb",
}
_LIBUSB_LINUX = "sudo apt-get install libusb-1.0-0"


def _backend() -> Any:  # noqa: ANN401 - pyusb's
    """Return pyusb's backend: that of the package libusb-package, or None, which lets it look itself."""
    try:
        import libusb_package
    except ImportError:
        return None
    return libusb_package.get_libusb1_backend()


def find_devices(vendor: int, product: int) -> list[usb.core.Device]:
    """Return the USB devices with these numbers. Raises LinkError where there is no libusb."""
    import usb.core

    try:
        found = usb.core.find(find_all=True, idVendor=vendor, idProduct=product, backend=_backend())
        return sorted(found, key=name_of)
    except usb.core.NoBackendError:
        mend = _LIBUSB.get(sys.platform, _LIBUSB_LINUX)
        raise LinkError(
            f"no libusb on this computer, by which USB is reached, expected one; {mend}"
        ) from None


def name_of(device: usb.core.Device) -> str:
    """Return a device's place: bus and ports from there on, as `lsusb -t` and dfu-util tell it ("3-1.4")."""
    ports = ".".join(map(str, getattr(device, "port_numbers", None) or (device.address,)))
    return f"{device.bus}-{ports}"


class UsbControl:
    """A `ControlLine` to the first interface of a device, claimed for this program alone."""

    def __init__(self, device: usb.core.Device, name: str) -> None:
        """name: as the user would write it. Raises LinkError for a device that this user may not open."""
        import usb.util

        self._device, self._name, self._util = device, name, usb.util
        self._open = True
        try:
            with self._told():
                self._claim()
                self.alternates = self._names()
        except BaseException:
            self.close()
            raise

    @property
    def name(self) -> str:
        """See ControlLine."""
        return self._name

    def read(self, request: int, value: int, size: int, timeout: float) -> bytes:
        """See ControlLine."""
        with self._told():
            got = self._device.ctrl_transfer(
                _CLASS_READ, request, value, INTERFACE, size, round(timeout * 1000)
            )
            return bytes(got)

    def write(self, request: int, value: int, data: bytes, timeout: float) -> None:
        """See ControlLine."""
        with self._told():
            self._device.ctrl_transfer(
                _CLASS_WRITE, request, value, INTERFACE, data or None, round(timeout * 1000)
            )

    def close(self) -> None:
        """See ControlLine."""
        if self._open:
            self._open = False
            self._util.dispose_resources(self._device)

    def _claim(self) -> None:
        """Configure the device where nobody has, and claim its interface."""
        import usb.core

        try:
            configured = self._device.get_active_configuration() is not None
        except usb.core.USBError:
            configured = False
        if not configured:
            self._device.set_configuration()
        self._util.claim_interface(self._device, INTERFACE)
        self._device.set_interface_altsetting(INTERFACE, 0)

    def _names(self) -> tuple[str, ...]:
        """Read the interface's name in each alternate setting, in their order."""
        found = {}
        for setting in self._device.get_active_configuration():
            if setting.bInterfaceNumber == INTERFACE and setting.bAlternateSetting < ALTERNATES_MAX:
                text = self._util.get_string(self._device, setting.iInterface) if setting.iInterface else ""
                found[setting.bAlternateSetting] = text or ""
        return tuple(found[number] for number in sorted(found))

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Make a LinkError of one line of what pyusb raises."""
        import usb.core

        try:
            yield
        except usb.core.USBTimeoutError:
            raise LineGoneError(
                f"{self.name}: no answer in time, expected one; plug the board out, and in again with BOOT "
                f"held"
            ) from None
        except (usb.core.USBError, NotImplementedError, ValueError) as error:
            raise _error(self.name, error) from None


def _error(name: str, error: Exception) -> LinkError:
    number = getattr(error, "errno", None)
    if number == errno.EPIPE:
        return StalledError(f"{name}: the device refuses a request, expected it to take it")
    if number in (errno.EACCES, errno.EPERM):
        return LinkError(
            f"{name}: permission denied, expected a USB device that this user may open; run: {INSTALL}; "
            f"then plug it in anew"
        )
    if number == errno.EBUSY:
        return LinkError(f"{name}: the device is in use, expected a free one; close the other program")
    if isinstance(error, NotImplementedError):  # libusb on Windows without WinUSB at the device
        return LinkError(
            f"{name}: Windows has no driver here by which programs reach the device, expected WinUSB; "
            f"install it with Zadig (zadig.akeo.ie) or ImpulseRC's driver fixer"
        )
    why = " ".join((getattr(error, "strerror", None) or str(error) or type(error).__name__).split()).lower()
    return LineGoneError(f"{name}: the device is gone ({why}), expected it to stay; check cable and power")
