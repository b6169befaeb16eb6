"""Certificates of `multicap serve --https`: one made on the spot by an authority in the data folder, or a given one."""

import datetime
import ipaddress
import json
import os
import socket
import ssl
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
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


_FOLDER = "certificates"
_AUTHORITY, _CERTIFICATE, _KEY = "authority.pem", "certificate.pem", "certificate-key.pem"
# A certificate is replaced at the first start within this time before its end.
_RENEWED_BEFORE = datetime.timedelta(days=30)
# An address for documentation: a socket that is connected to it by UDP sends nothing, and tells the way out.
_ELSEWHERE = ("192.0.2.1", 9)


class CertificateError(Exception):
    """A certificate can't be used; the text states the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class Encryption:
    """Certificate of a service with its key, and names by which clients may call it."""

    certificate: Path
    key: Path
    authority: Path | None  # Certificate of the authority, for phones; ``None`` of a given certificate
    names: tuple[str, ...]  # Host names and addresses; the first one is for phones
    has_replaced: bool = False  # True if phones that trusted an earlier authority have to trust this one again

    def environment(self, port: int, allowed_hosts: Sequence[str], public_url: str | None) -> Mapping[str, str]:
        """Settings of the web API: the files, and addresses by which it may be called."""
        name = f"[{self.names[0]}]" if ":" in self.names[0] else self.names[0]
        return {
            "MULTICAP_CERTIFICATE": str(self.certificate),
            "MULTICAP_CERTIFICATE_KEY": str(self.key),
            **({} if self.authority is None else {"MULTICAP_CERTIFICATE_AUTHORITY": str(self.authority)}),
            "MULTICAP_ALLOWED_HOSTS": json.dumps(sorted({*allowed_hosts, *self.names})),
            "MULTICAP_PUBLIC_URL": public_url or f"https://{name}:{port}",
        }

    def client_context(self) -> ssl.SSLContext:
        """Context of a client on this machine, which trusts this certificate whatever name it has."""
        context = ssl.create_default_context(cafile=str(self.authority or self.certificate))
        context.check_hostname = False
        if self.authority is None:
            context.verify_mode = ssl.CERT_NONE  # of an authority that this machine may not know
        return context


def own_encryption(data_dir: Path) -> Encryption:
    """Certificate for the names and addresses of this machine, by an authority for it in a data folder.

    The key of the authority is never stored: what phones trust has signed this certificate, and can sign nothing else.
    Both are kept until shortly before their end, unless the machine has another name or another address in the network
    of its phones.
    """
    folder = data_dir / _FOLDER
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        is_there = any((folder / name).exists() for name in (_AUTHORITY, _CERTIFICATE, _KEY))
        if not is_there or (kept := _kept(folder)) is None:
            return _new(folder, has_replaced=is_there)
    except OSError as error:
        message = f"The certificates in {folder} can't be read or written: {error.strerror}. Check its owner and mode."
        raise CertificateError(message) from error
    return kept


def _kept(folder: Path) -> Encryption | None:
    """Certificate in a folder; ``None`` if it is damaged, ends soon, or lacks what phones and this machine call."""
    certificate, key, authority = folder / _CERTIFICATE, folder / _KEY, folder / _AUTHORITY
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password=_no_password)
        found, issuer = (x509.load_pem_x509_certificate(path.read_bytes()) for path in (certificate, authority))
        certified = set(_certificate_names(found))
    except (ssl.SSLError, FileNotFoundError, ValueError):
        return None
    names, until = list(machine_names()), datetime.datetime.now(datetime.UTC) + _RENEWED_BEFORE
    needed = [names[0], *(name for name in names if isinstance(general_name(name), x509.DNSName))]
    if not is_limited(issuer) or not all(is_trusted(found, issuer, name, until) for name in needed):
        return None
    return Encryption(certificate, key, authority, tuple(name for name in names if name in certified))


def _new(folder: Path, *, has_replaced: bool) -> Encryption:
    names, now = tuple(machine_names()), datetime.datetime.now(datetime.UTC)
    authority = new_authority(_host_name() or "a machine", names, now)
    signed, key = authority.sign(names)
    contents = {
        _KEY: (pem_of_key(key), 0o600),
        _CERTIFICATE: (pem_of_certificate(signed), 0o644),
        _AUTHORITY: (pem_of_certificate(authority.certificate), 0o644),
    }
    for name, (content, mode) in contents.items():
        part = folder / f"{name}.part"
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(content)
        part.replace(folder / name)
    return Encryption(folder / _CERTIFICATE, folder / _KEY, folder / _AUTHORITY, names, has_replaced)


def given_encryption(certificate: Path, key: Path) -> Encryption:
    """Certificate of the operator's own with its key; raises ``CertificateError`` if they do not belong together."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password=_no_password)
        names = tuple(_certificate_names(x509.load_pem_x509_certificate(certificate.read_bytes())))
    except (OSError, ValueError) as error:  # SSLError is an OSError
        message = (
            f"The certificate {certificate.name} can't be used with the key {key.name}: both must be readable PEM "
            "files that belong together, the key without a password."
        )
        raise CertificateError(message) from error
    if not names:
        message = f"The certificate {certificate.name} names no host; it needs one by which phones call this machine."
        raise CertificateError(message)
    return Encryption(certificate, key, None, names)


def machine_names() -> Iterator[str]:
    """Addresses and names of this machine, the address on the way to its network first, without doubles.

    Addresses of IPv6 change by themselves and are left out. So is the bare name of the machine: an authority for the
    name `dev` would be one for a whole top-level domain.
    """
    host = _host_name()
    local = [f"{host}.local"] if host else []
    yield from dict.fromkeys([*_way_out(), *_addresses(), *local, "localhost", "127.0.0.1", "::1"])


def _way_out() -> Iterator[str]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        try:
            way.connect(_ELSEWHERE)
        except OSError:  # no network
            return
        yield way.getsockname()[0]


def _addresses() -> Iterator[str]:
    """Addresses of this machine by IPv4 that others may reach."""
    found = [
        ipaddress.IPv4Address(address.address)
        for addresses in psutil.net_if_addrs().values()
        for address in addresses
        if address.family == socket.AF_INET
    ]
    yield from (str(address) for address in sorted(found) if not address.is_loopback)


def _host_name() -> str:
    name = socket.gethostname().partition(".")[0].lower()
    return name if name.isascii() and name.replace("-", "").isalnum() else ""


def _certificate_names(certificate: x509.Certificate) -> Iterator[str]:
    """Names and addresses in a certificate by which a client may call the service."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return
    yield from (name for name in names.get_values_for_type(x509.DNSName) if "*" not in name)
    yield from map(str, names.get_values_for_type(x509.IPAddress))


def _no_password() -> str:
    """Refuse to ask for a password at the terminal."""
    return ""
