"""Certificates of a session for TLS: a small authority of its own, and certificates that it signs. All as DER.

Nothing else is trusted: both sides verify against the session's authority, which is pinned in every key. So host names
are not checked, and certificates are valid from 1970 to 2200, also for a node whose clock was never set.
"""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

_FROM: Final = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_UNTIL: Final = datetime.datetime(2200, 1, 1, tzinfo=datetime.UTC)
SERVER: Final = "server"
"""Common name of the server's certificate."""


class Certified(NamedTuple):
    """A certificate and its private key.

    Attributes:
        certificate: X.509, as DER.
        private_key: Ed25519 in PKCS 8, as DER.
    """

    certificate: bytes
    private_key: bytes


def make_authority(session: str) -> Certified:
    """Make a session's certificate authority, with a self-signed certificate."""
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.generate()
    name = _name(f"mocapella {session}")
    builder = _builder(name, name, key).add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return _pack(builder.sign(key, None), key)


def issue(authority: Certified, common_name: str) -> Certified:
    """Issue a certificate: for a server if the common name is `SERVER`, else for a client, which cannot be a server."""
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_der_private_key
    from cryptography.x509.oid import ExtendedKeyUsageOID

    signer = load_der_private_key(authority.private_key, None)
    assert isinstance(signer, Ed25519PrivateKey)
    issuer = x509.load_der_x509_certificate(authority.certificate).subject
    key = Ed25519PrivateKey.generate()
    usage = ExtendedKeyUsageOID.SERVER_AUTH if common_name == SERVER else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = (
        _builder(_name(common_name), issuer, key)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=True)
    )
    return _pack(builder.sign(signer, None), key)


def _name(common_name: str) -> x509.Name:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(subject: x509.Name, issuer: x509.Name, key: Ed25519PrivateKey) -> x509.CertificateBuilder:
    from cryptography import x509

    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(_FROM)
        .not_valid_after(_UNTIL)
    )


def _pack(certificate: x509.Certificate, key: Ed25519PrivateKey) -> Certified:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    private = key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
    return Certified(certificate.public_bytes(Encoding.DER), private)
