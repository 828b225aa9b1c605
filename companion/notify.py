"""Messages to systemd (sd_notify): ready, alive, status.

One datagram to the socket that $NOTIFY_SOCKET names, as sd_notify(3) describes. Deviation from the design, which names
the package sdnotify: its last release is of 2017, without a wheel, for what is one `sendto`.
"""

import os
import socket


class Notifier:
    """Tells systemd how the service is; does nothing where nobody listens."""

    def __init__(self, address: str | None) -> None:
        """Prepare for the value of $NOTIFY_SOCKET; None or empty: not started by systemd."""
        self._address = "\0" + address[1:] if address and address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) if address else None

    @classmethod
    def from_environment(cls) -> "Notifier":
        """The notifier that systemd has asked for; child processes shall not inherit it."""
        return cls(os.environ.pop("NOTIFY_SOCKET", None))

    def send(self, **fields: str) -> None:
        """Send assignments, such as READY="1"; a systemd that is busy or gone is no reason to stop."""
        if self._socket is None or self._address is None:
            return
        text = "\n".join(f"{name}={value}" for name, value in fields.items())
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError:
            return

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
