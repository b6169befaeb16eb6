"""Authority of `multicap serve --https`: it signs a certificate for the names of one machine; its key is not stored."""

import datetime
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from cryptography.x509.verification import PolicyBuilder, Store, VerificationError

VALID_DAYS = 397
"""Days for which an authority and its certificate are valid: phones refuse certificates of more than 825 days."""

_EARLIER = datetime.timedelta(days=1)  # clocks of phones may be late
_ORGANIZATION = "Multicap"
_SERVERS = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
_USAGES = (
    *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
    *("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Authority:
    """Certificate of an authority with its private key, which exists in the memory of one process alone."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    def sign(self, names: Sequence[str]) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
        """Certificate of a server with names and addresses, and its private key; ends with the authority."""
        key, issuer = ec.generate_private_key(ec.SECP256R1()), self.certificate
        names_of_server = x509.SubjectAlternativeName([general_name(name) for name in names])
        # A subject that could be a host name would be compared with the constraints, too.
        builder = _builder(_subject("Multicap service"), issuer.subject, key.public_key(), issuer.not_valid_before_utc)
        signed = (
            builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage("digital_signature"), critical=True)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self.key.public_key()), critical=False)
            .add_extension(names_of_server, critical=False)
            .sign(self.key, hashes.SHA256())
        )
        return signed, key


def new_authority(machine: str, names: Sequence[str], now: datetime.datetime) -> Authority:
    """Authority that can sign for some names and addresses alone.

    It may sign for servers only, for no authority below it, and by its name constraints (RFC 5280, 4.2.1.10) for these
    names and addresses only; a name of one word would stand for a whole top-level domain and is left out, but for
    ``localhost``.

    ``machine``: name of the machine, which phones show among their authorities. ``names``: host names and addresses.
    ``now``: time from which it is valid.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _subject(f"Multicap on {machine}, {now:%Y-%m-%d %H:%M}"[:64])
    permitted = [_subtree(name) for name in names if "." in name or ":" in name or name == "localhost"]
    certificate = (
        _builder(subject, subject, key.public_key(), now - _EARLIER)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage("key_cert_sign"), critical=True)
        .add_extension(x509.NameConstraints(permitted, None), critical=True)
        .sign(key, hashes.SHA256())
    )
    return Authority(certificate, key)


def is_trusted(certificate: x509.Certificate, authority: x509.Certificate, name: str, now: datetime.datetime) -> bool:
    """Return whether clients that trust an authority accept a server's certificate for a name or an address then."""
    verifier = PolicyBuilder().store(Store([authority])).time(now).build_server_verifier(general_name(name))
    try:
        verifier.verify(certificate, [])
    except VerificationError:
        return False
    return True


def is_limited(authority: x509.Certificate) -> bool:
    """Return whether an authority has name constraints."""
    try:
        authority.extensions.get_extension_for_class(x509.NameConstraints)
    except x509.ExtensionNotFound:
        return False
    return True


def general_name(name: str) -> x509.DNSName | x509.IPAddress:
    """Host name or address as certificates hold it."""
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def pem_of_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Private key in PEM, without a password."""
    no_password = serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, no_password)


def pem_of_certificate(certificate: x509.Certificate) -> bytes:
    """Certificate in PEM."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def _subtree(name: str) -> x509.DNSName | x509.IPAddress:
    """Name constraint of a host name, or of one address."""
    found = general_name(name)
    return found if isinstance(found, x509.DNSName) else x509.IPAddress(ipaddress.ip_network(name))


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, start: datetime.datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(start + datetime.timedelta(days=VALID_DAYS))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
        .add_extension(_SERVERS, critical=False)
    )


def _subject(common_name: str) -> x509.Name:
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, _ORGANIZATION),
            x509.NameAttribute(NameOID.COMMON_NAME, common_name[:64]),
        ]
    )


def _usage(allowed: str) -> x509.KeyUsage:
    return x509.KeyUsage(**{usage: usage == allowed for usage in _USAGES})
