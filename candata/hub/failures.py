"""What the Hub refuses, and what keeps it from answering, as errors that say what to do."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from candata.errors import CandataError, MissingExtraError, SetupError, UsageError
from candata.hub.address import HubAddress

#: How to give a token.
LOG_IN = "log in with `hf auth login`, or set HF_TOKEN"
#: Statuses of HTTP: not logged in, forbidden, a size or number of requests that is too much. Source: RFC 9110, 6585.
UNAUTHORISED, FORBIDDEN, TOO_MANY = 401, 403, 429


def hub_library() -> Any:
    """Return the module huggingface_hub.

    Raises
    ------
    MissingExtraError
        When it is not installed.
    """
    try:
        import huggingface_hub
    except ImportError:
        raise MissingExtraError("huggingface_hub", "hub") from None
    return huggingface_hub


def hub_api() -> Any:
    """Return the client of the Hub that HF_ENDPOINT names, huggingface.co by default."""
    return hub_library().HfApi(endpoint=os.environ.get("HF_ENDPOINT") or None)


@contextmanager
def hub_failures(address: HubAddress) -> Iterator[None]:
    """Turn what the Hub and the network raise inside into errors with an address and a way out.

    Raises
    ------
    UsageError
        When the repository or the revision does not exist, as far as the Hub tells.
    SetupError
        When there is no network, the Hub fails, or the token is missing, wrong or not allowed to.
    """
    hub_library()
    from huggingface_hub import errors

    try:
        yield
    except (errors.HTTPError, errors.OfflineModeIsEnabled, errors.EntryNotFoundError) as error:
        raise _translated(error, address) from None


def _translated(error: Exception, address: HubAddress) -> CandataError:
    """Return the error to show for one of the Hub's."""
    from huggingface_hub import errors, get_token

    if isinstance(error, errors.RevisionNotFoundError):
        return UsageError(
            f"{address.repository} has no revision {address.revision or 'main'}",
            expected="a branch, a tag or a commit of it",
            fix=f"look at its branches and tags on the Hub, or leave out @{address.revision or 'main'}",
        )
    if isinstance(error, errors.GatedRepoError):
        return SetupError(
            f"{address.repository} is gated: its owner asks who reads it",
            found=_status(error),
            fix=f"accept its terms on its page with your account, then {LOG_IN}",
        )
    status = getattr(getattr(error, "response", None), "status_code", None)
    if isinstance(error, errors.RepositoryNotFoundError) or status == UNAUTHORISED:
        return _not_found(address, has_token=bool(get_token()), found=_status(error))
    if status == FORBIDDEN:
        return SetupError(
            f"the token is not allowed to do this with {address.repository}",
            expected="a token that may read it, and write to it for a push",
            found=_status(error),
            fix="make such a token on the Hub under Settings, Access Tokens, and set HF_TOKEN to it",
        )
    if status is not None:
        wait = "wait a few minutes, then run it again" if status == TOO_MANY or status >= 500 else "run it again later"
        return SetupError(
            f"the Hub refused a request about {address.repository}",
            found=_status(error),
            fix=f"{wait}: it goes on where it stopped",
        )
    return SetupError(
        "the Hub cannot be reached",
        expected=f"an answer about {address.repository}",
        found=_first_line(error),
        fix="connect to the network (and unset HF_HUB_OFFLINE) and run it again: it goes on where it stopped; "
        "or give the folder of a set that was downloaded before",
    )


def _not_found(address: HubAddress, has_token: bool, found: str) -> CandataError:
    """Return the error of a repository that the Hub does not show: it does not tell a private one from none."""
    if not has_token:
        return UsageError(
            f"the Hub shows no data set {address.repository} to those who are not logged in",
            found=f"{found}, no token",
            fix=f"check its name; if it is private, {LOG_IN}",
        )
    return UsageError(
        f"the Hub shows no data set {address.repository} to the owner of this token",
        found=found,
        fix="check its name; if it is private, ask its owner for access, or give a token that may read it",
    )


def _status(error: Exception) -> str:
    """Return the status of an answer and the words of the server, if any."""
    response = getattr(error, "response", None)
    status = "no answer" if response is None else f"HTTP {response.status_code}"
    message = getattr(error, "server_message", None)
    return f"{status}: {str(message).splitlines()[0][:200]}" if message else status


def _first_line(error: Exception) -> str:
    """Return the first line of an error, or its name."""
    return (str(error).splitlines() or [""])[0][:200] or type(error).__name__
