"""Certificate of a virtual scanner with the measurements of a metrology laboratory."""

from .certificate import Certificate, Scope
from .certify import certify
from .sheet import CERTIFICATE, describe, write_certificate

__all__ = ["CERTIFICATE", "Certificate", "Scope", "certify", "describe", "write_certificate"]
