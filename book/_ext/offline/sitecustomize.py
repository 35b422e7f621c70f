"""No network for the notebooks: on PYTHONPATH, this lets sockets reach this machine only."""

import socket

_getaddrinfo, _connect = socket.getaddrinfo, socket.socket.connect
HERE = ("localhost", "127.0.0.1", "::1", "", None, socket.gethostname())


def _refused(host: object) -> OSError:
    return OSError(f"{host!r}: the network is cut off while notebooks run")


def getaddrinfo(host, *args, **options):
    if host not in HERE:
        raise _refused(host)
    return _getaddrinfo(host, *args, **options)


def connect(self, address):
    if self.family in (socket.AF_INET, socket.AF_INET6) and address[0] not in HERE:
        raise _refused(address[0])
    return _connect(self, address)


socket.getaddrinfo, socket.socket.connect = getaddrinfo, connect
