"""Rules for udev, Linux' keeper of devices, that let the user at the computer open boards on USB.

`uaccess` gives a device to whoever sits at the computer, in files whose number is below 73 (systemd's
73-seat-late.rules); who is not there, but on SSH, needs the device's group. ModemManager sends commands for
modems to every new serial port unless ID_MM_DEVICE_IGNORE is set (its documentation, "udev tags").
"""

from __future__ import annotations

from neuroflight.flash.usb.devices import BOOT_LOADER, DISK, SERIAL_PORT

FILE = "/etc/udev/rules.d/45-neuroflight.rules"
INSTALL = f"neuroflight doctor --udev | sudo tee {FILE} && sudo udevadm control --reload"


def udev_rules() -> str:
    """Return the content of the rules' file."""
    lines = [f"# {FILE}: boards with Neuroflight. After a change, plug the board in anew."]
    for (vendor, product), subsystem, attribute, more in (
        (SERIAL_PORT, "tty", "ATTRS", ', ENV{ID_MM_DEVICE_IGNORE}="1"'),
        (DISK, "usb", "ATTR", ""),
        (BOOT_LOADER, "usb", "ATTR", ""),
    ):
        ids = ((attribute + "{idVendor}", vendor), (attribute + "{idProduct}", product))
        matches = [f'SUBSYSTEM=="{subsystem}"', *(f'{name}=="{value:04x}"' for name, value in ids)]
        lines.append(f'{", ".join(matches)}, TAG+="uaccess"{more}')
    return "\n".join(lines) + "\n"
