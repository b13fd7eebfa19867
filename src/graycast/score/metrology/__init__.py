"""Certificate of a virtual camera: flatness, spheres, noise, focus, as a metrology lab measures."""

from .certificate import Certificate, Scope
from .certify import certify
from .sheet import CERTIFICATE, describe, write_certificate

__all__ = ["CERTIFICATE", "Certificate", "Scope", "certify", "describe", "write_certificate"]
