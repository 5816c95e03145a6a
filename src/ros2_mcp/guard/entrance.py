"""The HTTP endpoint: its address, accepted host names and login, checked before the start."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from ros2_mcp.guard.state import state_home
from ros2_mcp.guard.tokens import Tokens, own_token, own_tokens, read_tokens
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.shell import typed
from ros2_mcp.settings import OPTIONS, Settings

NO_LOGIN = (
    "No login is asked for (--no-login): every program and every user of this machine can use this server and move the "
    "robot."
)
_EVERYWHERE = ("0.0.0.0", "::")
_USUAL_PORTS = {"http": 80, "https": 443}
"""Default ports, which URLs omit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entrance:
    """The checked settings of the HTTP endpoint.

    `tokens` is None without a login; `told` is the message for the person who starts the server. `hosts` and `origins`
    are the accepted values of the headers Host and Origin.
    """

    url: str
    tokens: Tokens | None
    hosts: tuple[str, ...]
    origins: tuple[str, ...]
    told: str


def entrance_of(settings: Settings) -> Entrance:
    """Return the HTTP endpoint for these settings; create the server's own token at the first start.

    Raises:
        BadInput: for settings that would admit strangers, or tokens that cannot be used.
    """
    _check(settings)
    if settings.no_login:
        tokens, told = None, f"Warning: {NO_LOGIN}"
    elif settings.token_file:
        tokens, told = read_tokens(settings.token_file.expanduser()), f"A token of {settings.token_file} is asked for."
    else:
        folder = state_home()
        token, is_new = own_token(folder)
        tokens, told = own_tokens(folder), _told_of_own(folder, token if is_new else "", settings)
    hosts = _hosts(settings)
    origins = tuple(f"{_scheme(settings)}://{host}" for host in hosts)
    if settings.public_url:
        public = urlsplit(settings.public_url)
        hosts += _as_written(public.netloc.lower(), public.scheme)
        origins += tuple(f"{public.scheme}://{host}" for host in _as_written(public.netloc.lower(), public.scheme))
    elif settings.host.strip("[]") in _EVERYWHERE:
        told += "\nClients of other machines are refused (421) until --public-url says at which address they find it."
    return Entrance(url=url_of(settings), tokens=tokens, hosts=hosts, origins=origins, told=told)


def check_tls(settings: Settings) -> None:
    """Check before the start that TLS works with the configured certificate and key.

    Raises:
        BadInput: if they cannot be used.
    """
    if not settings.tls_cert or not settings.tls_key:
        return
    import ssl  # stdio does not need it

    certificate, key = settings.tls_cert.expanduser(), settings.tls_key.expanduser()
    try:
        # Without a password, OpenSSL would prompt for one at the terminal.
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=lambda: b"")
    except OSError as error:
        reason = "OpenSSL does not take them" if isinstance(error, ssl.SSLError) else error.strerror
        raise BadInput(
            f"TLS cannot use {certificate} and {key}: {reason}.",
            "Both must be PEM files that this user can read; the key must fit the certificate and have no password.",
        ) from error


def warnings_of(settings: Settings) -> list[str]:
    """Return the warnings about the endpoint that `ros2_status` shows."""
    return [NO_LOGIN] if settings.no_login and settings.is_http else []


def url_of(settings: Settings) -> str:
    """Return the URL of this server for clients."""
    if settings.public_url:
        url = settings.public_url.rstrip("/")
        return url if urlsplit(url).path else f"{url}/mcp"
    host = settings.host.strip("[]")
    written = f"[{host}]" if ":" in host else host
    return f"{_scheme(settings)}://{written}:{settings.port}/mcp"


def is_loopback(host: str) -> bool:
    """Return whether the address can only be reached from this machine."""
    try:
        return ipaddress.ip_address(host.strip("[]").partition("%")[0]).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _check(settings: Settings) -> None:
    if settings.socket:
        raise BadInput("--socket and --transport contradict each other.", "Give one of them.")
    title = {name: option.flag for name, option in OPTIONS.items()}
    if bool(settings.tls_cert) != bool(settings.tls_key):
        raise BadInput(f"{title['tls_cert']} and {title['tls_key']} belong together.", "Give both.")
    is_local = is_loopback(settings.host)
    if settings.no_login and (not is_local or settings.behind_proxy or settings.public_url):
        raise BadInput(
            "--no-login would give access to anyone who reaches this server over the network.",
            "It is only for this machine (--host 127.0.0.1, no proxy). Leave it out: a token is made automatically.",
        )
    if settings.no_login and settings.token_file:
        raise BadInput("--no-login and --token-file contradict each other.", "Give one of them.")
    if not is_local and not settings.tls_cert and not settings.behind_proxy:
        raise BadInput(
            f"--host {settings.host} is reached from other machines: the token would cross the network in the open.",
            "Give --tls-cert and --tls-key, or --behind-proxy if a proxy speaks TLS in front of this server, or listen "
            "on 127.0.0.1.",
        )


def _hosts(settings: Settings) -> tuple[str, ...]:
    """Return the accepted Host values for this machine's own names and for the address that the server listens on."""
    names = ["127.0.0.1", "localhost", "[::1]"]
    host = settings.host.strip("[]")
    if host not in _EVERYWHERE:
        written = f"[{host}]" if ":" in host else host
        names += [written, written.lower()]  # browsers send names in lower case
    at = [f"{name}:{settings.port}" for name in dict.fromkeys(names)]
    return (*at, *(names if settings.port == _USUAL_PORTS[_scheme(settings)] else ()))


def _as_written(netloc: str, scheme: str) -> tuple[str, ...]:
    """Return the spellings of a public address: with and without the default port."""
    usual = f":{_USUAL_PORTS[scheme]}"
    bare = netloc.removesuffix(usual)
    return (netloc,) if urlsplit(f"//{bare}").port else (bare, bare + usual)


def _scheme(settings: Settings) -> str:
    return "https" if settings.tls_cert else "http"


def _told_of_own(folder: Path, new_token: str, settings: Settings) -> str:
    configures = (
        f"What configures a client with it:  {_config_command(settings)}  (such as claude-code, vscode, cursor)"
    )
    if not new_token:
        return f"A token is asked for: that of {folder / 'http-token'}.\n{configures}"
    return (
        f"A token is asked for. It was made now, is kept in {folder / 'http-token'}, and is shown this once:\n"
        f"  Authorization: Bearer {new_token}\n{configures}"
    )


def _config_command(settings: Settings) -> str:
    """Return the command that configures a client, with the options that decide how clients reach this server."""
    words, usual = ["ros2-mcp"], Settings()
    for name in ("host", "port", "tls_cert", "tls_key", "behind_proxy", "public_url"):
        value = getattr(settings, name)
        if value != getattr(usual, name):
            words += [OPTIONS[name].flag, *([] if value is True else [str(value)])]
    return f"{typed(words)} config CLIENT --http"
