"""A stand-in for the Hub: as much of its HTTP interface as a download and a push of a data set use."""

from __future__ import annotations

import base64
import hashlib
import json
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

TOKEN = "hf_good"


@dataclass
class Repository:
    """A data set: files by commit, names of commits."""

    commits: dict[str, dict[str, bytes]] = field(default_factory=dict)
    refs: dict[str, str] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)
    private: bool = False
    gated: bool = False
    licence: str | None = None

    def commit(self, files: dict[str, bytes]) -> str:
        """Add a commit on main."""
        content = repr(sorted((name, hashlib.sha1(data).hexdigest()) for name, data in files.items()))
        sha = hashlib.sha1((content + str(len(self.commits))).encode()).hexdigest()
        self.commits[sha], self.refs["main"] = dict(files), sha
        return sha

    def resolve(self, revision: str) -> str | None:
        """Return the commit of a branch, a tag or a commit."""
        return self.refs.get(revision) or self.tags.get(revision) or (revision if revision in self.commits else None)


class StandInHub(ThreadingHTTPServer):
    """The server; `asked` are the requests of files, `broken` files whose first answer breaks off half way."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.repositories: dict[str, Repository] = {}
        self.asked: list[tuple[str, str, str | None]] = []
        self.broken: set[str] = set()
        self.status: int | None = None
        self.readonly = False
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        """Address of the server."""
        return f"http://127.0.0.1:{self.server_address[1]}"

    def handle_error(self, request, client_address) -> None:
        """Say nothing of clients that go away."""


class Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    protocol_version = "HTTP/1.1"
    server: StandInHub

    def log_message(self, *_) -> None:
        """Say nothing."""

    def do_GET(self) -> None:
        self.answer()

    do_HEAD = do_POST = do_DELETE = do_GET

    def answer(self) -> None:
        """Read the body and send what the path asks for."""
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        parts = [unquote(part) for part in urlsplit(self.path).path.strip("/").split("/")]
        if self.server.status is not None:
            self.send_json({"error": "busy"}, self.server.status)
        elif parts == ["api", "validate-yaml"]:
            self.send_json({"warnings": [], "errors": []})
        elif parts == ["api", "repos", "create"]:
            self.create(json.loads(body))
        elif parts[:2] == ["api", "datasets"]:
            repository = self.repository("/".join(parts[2:4]))
            if repository is not None:
                self.api(repository, parts[4:], body)
        elif parts[0] == "datasets" and parts[3] == "resolve":
            repository = self.repository("/".join(parts[1:3]))
            if repository is not None:
                self.send_file(repository, parts[4], "/".join(parts[5:]))
        else:
            self.send_json({"error": "unknown path"}, 404)

    @property
    def has_token(self) -> bool:
        return self.headers.get("Authorization") == f"Bearer {TOKEN}"

    def repository(self, name: str) -> Repository | None:
        """Return a repository, or refuse as the Hub does."""
        repository = self.server.repositories.get(name)
        if repository is not None and repository.gated and not self.has_token:
            self.send_json({"error": "gated"}, 401, {"X-Error-Code": "GatedRepo"})
        elif repository is None or (repository.private and not self.has_token):
            status = 404 if self.has_token else 401
            self.send_json({"error": "Repository not found"}, status, {"X-Error-Code": "RepoNotFound"})
        else:
            return repository
        return None

    def create(self, request: dict) -> None:
        """Make a repository."""
        name = f"{request.get('organization', 'me')}/{request['name']}"
        if not self.has_token or self.server.readonly:
            self.send_json({"error": "You don't have the rights"}, 403)
        elif name in self.server.repositories:
            self.send_json({"error": "exists", "url": f"{self.server.url}/datasets/{name}"}, 409)
        else:
            self.server.repositories[name] = Repository(private=request.get("visibility") == "private")
            self.server.repositories[name].commit({})
            self.send_json({"url": f"{self.server.url}/datasets/{name}"})

    def api(self, repository: Repository, path: list[str], body: bytes) -> None:
        """Answer a request about one repository."""
        verb = path[0] if path else "revision"
        revision = path[1] if len(path) > 1 else "main"
        if verb == "refs":
            tags = [{"name": n, "ref": f"refs/tags/{n}", "targetCommit": c} for n, c in repository.tags.items()]
            self.send_json({"branches": [], "converts": [], "tags": tags})
        elif verb == "tag" and self.command == "DELETE":
            del repository.tags[revision]
            self.send_json({})
        elif verb == "preupload":
            files = json.loads(body)["files"]
            self.send_json(
                {"files": [{"path": f["path"], "uploadMode": "regular", "shouldIgnore": False} for f in files]}
            )
        elif verb == "commit":
            self.commit(repository, body)
        else:
            commit = repository.resolve(revision)
            if commit is None:
                self.send_json({"error": "Invalid rev id"}, 404, {"X-Error-Code": "RevisionNotFound"})
            elif verb == "tag":
                repository.tags[json.loads(body)["tag"]] = commit
                self.send_json({})
            elif verb == "tree":
                self.send_json(tree(repository.commits[commit]))
            else:
                self.send_json(info(self.path, repository, commit))

    def commit(self, repository: Repository, body: bytes) -> None:
        """Apply a commit as lines of JSON."""
        files = dict(repository.commits[repository.refs["main"]])
        for line in map(json.loads, body.splitlines()):
            if line["key"] == "file":
                files[line["value"]["path"]] = base64.b64decode(line["value"]["content"])
            elif line["key"] == "deletedFile":
                del files[line["value"]["path"]]
        oid = repository.commit(files)
        name = "/".join(urlsplit(self.path).path.split("/")[3:5])
        self.send_json({"commitUrl": f"{self.server.url}/datasets/{name}/commit/{oid}", "commitOid": oid})

    def send_file(self, repository: Repository, revision: str, name: str) -> None:
        """Send a file, or what a range of it asks for."""
        commit = repository.resolve(revision)
        data = repository.commits[commit].get(name) if commit else None
        if data is None:
            self.send_json({"error": "Entry not found"}, 404, {"X-Error-Code": "EntryNotFound"})
            return
        requested_range = self.headers.get("Range")
        if self.command == "GET":
            self.server.asked.append((name, commit, requested_range))
        start = int(requested_range.removeprefix("bytes=").split("-")[0]) if requested_range else 0
        self.send_response(206 if start else 200)
        self.send_header("ETag", f'"{hashlib.sha1(data).hexdigest()}"')
        self.send_header("X-Repo-Commit", commit)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(len(data) - start))
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
        self.end_headers()
        if self.command == "GET":
            breaks = name in self.server.broken
            self.wfile.write(data[start : start + (len(data) - start) // 2] if breaks else data[start:])
            if breaks:
                self.close_connection = True

    def send_json(self, value: object, status: int = 200, headers: dict[str, str] | None = None) -> None:
        """Send a value as JSON."""
        text = json.dumps(value).encode()
        self.send_response(status)
        for name, content in (headers or {}).items():
            self.send_header(name, content)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)


def tree(files: dict[str, bytes]) -> list[dict]:
    """Return the list of files."""
    return [
        {"type": "file", "path": name, "size": len(data), "oid": hashlib.sha1(data).hexdigest()}
        for name, data in files.items()
    ]


def info(path: str, repository: Repository, commit: str) -> dict:
    """Return what is known of a repository."""
    siblings = [{"rfilename": name, "size": len(data)} for name, data in repository.commits[commit].items()]
    card = {"license": repository.licence} if repository.licence else {}
    return {
        "id": path,
        "sha": commit,
        "private": repository.private,
        "siblings": siblings,
        "cardData": card,
        "tags": [],
    }
