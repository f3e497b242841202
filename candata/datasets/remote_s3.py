"""S3 as a remote, through obstore: of a cloud, or a store of one's own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any
from urllib.parse import urlsplit

from candata.datasets.store import CHUNK_BYTES
from candata.errors import MissingExtraError, SetupError, Where
from candata.schema.registry import RemoteEntry

#: Any one of these in the environment is a way to sign requests.
CREDENTIALS = (
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)

#: A file up to this size is sent in one request; a larger one in parts, two at a time.
_WHOLE_BYTES = 8 * 2**20
_RETRIES = {"max_retries": 4, "retry_timeout": timedelta(seconds=60)}


class S3Store:
    """A prefix of a bucket; credentials come from the environment and are never kept."""

    def __init__(self, entry: RemoteEntry) -> None:
        try:
            from obstore.store import S3Store as Bucket
        except ImportError:
            raise MissingExtraError("obstore", "remote") from None
        if not entry.anonymous and not any(os.environ.get(name) for name in CREDENTIALS):
            raise SetupError(
                "no credentials for S3",
                expected=f"one of {', '.join(CREDENTIALS)} in the environment",
                where=Where(path=entry.url),
                fix="set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
            )
        parts = urlsplit(entry.url)
        self._url = entry.url.rstrip("/")
        options: dict[str, Any] = {"region": entry.region or os.environ.get("AWS_REGION") or "us-east-1"}
        options |= {"endpoint": entry.endpoint} if entry.endpoint else {}
        options |= {"skip_signature": True} if entry.anonymous else {}
        with self._translated_errors(""):
            self._bucket = Bucket(
                parts.netloc,
                prefix=parts.path.strip("/") or None,
                virtual_hosted_style_request=not entry.path_style,
                client_options={"allow_http": entry.allow_http},
                retry_config=_RETRIES,  # type: ignore[arg-type]
                **options,
            )

    @property
    def url(self) -> str:
        """Address of the remote."""
        return self._url

    def folders(self) -> list[str]:
        """Return the names of the folders at its root, sorted."""
        import obstore

        with self._translated_errors(""):
            prefixes = obstore.list_with_delimiter(self._bucket)["common_prefixes"]
        return sorted(prefix.rstrip("/").rsplit("/", 1)[-1] for prefix in prefixes)

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the files in a folder by name, with their size in bytes."""
        import obstore

        head = f"{prefix}/"
        with self._translated_errors(prefix):
            size_by_path = {
                meta["path"]: meta["size"] for batch in obstore.list(self._bucket, prefix) for meta in batch
            }
        return {path[len(head) :]: size for path, size in size_by_path.items() if path.startswith(head)}

    def read(self, key: str) -> Iterator[bytes]:
        """Yield the bytes of a file; raises FileNotFoundError where there is none."""
        import obstore

        with self._translated_errors(key):
            for chunk in obstore.get(self._bucket, key).stream(min_chunk_size=CHUNK_BYTES):
                yield bytes(chunk)

    def write(self, key: str, chunks: Iterable[bytes], size: int) -> None:
        """Keep a file, whole or not at all; one that stands is replaced."""
        import obstore

        content = b"".join(chunks) if size <= _WHOLE_BYTES else None
        with self._translated_errors(key):
            if content is not None:
                obstore.put(self._bucket, key, content, use_multipart=False)
            else:
                obstore.put(self._bucket, key, iter(chunks), chunk_size=_WHOLE_BYTES, max_concurrency=2)

    def create(self, key: str, data: bytes) -> bool:
        """Keep a file unless one stands (`If-None-Match: *`); return whether this call made it."""
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with self._translated_errors(key):
            try:
                obstore.put(self._bucket, key, data, mode="create")
            except AlreadyExistsError:
                return False
        return True

    def tidy(self, name: str) -> None:
        """Do nothing: what is half sent cannot be seen on S3; the bucket's own rules end broken uploads."""

    @contextmanager
    def _translated_errors(self, key: str) -> Iterator[None]:
        """Turn what obstore raises into errors of ours, in one line; a missing file stays FileNotFoundError."""
        from obstore.exceptions import BaseError, NotSupportedError, PermissionDeniedError, UnauthenticatedError

        try:
            yield
        except (PermissionDeniedError, UnauthenticatedError, PermissionError) as error:
            raise self._failure(
                "the store refuses access", error, key, "check the credentials and the bucket"
            ) from None
        except (NotSupportedError, NotImplementedError) as error:
            fix = "use a store that knows conditional writes (If-None-Match), which publishing needs"
            raise self._failure("the store cannot do this", error, key, fix) from None
        except BaseError as error:
            fix = "check address, endpoint, region and network; what was moved so far counts"
            raise self._failure("the remote cannot be used", error, key, fix) from None

    def _failure(self, problem: str, error: BaseException, key: str, fix: str) -> SetupError:
        """Return the error for a store that cannot be used."""
        return SetupError(problem, found=_one_line(error), where=Where(path=f"{self._url}/{key}"), fix=fix)


def _one_line(error: BaseException) -> str:
    """Return what was said, without the debug text that follows."""
    text = str(error).split("\n\nDebug", 1)[0]
    return " ".join(text.split())[:300]
