"""S3 by moto, with weather: buckets of a server in this process, whose requests tests refuse or slow down."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl

import boto3
from moto.server import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import make_server

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


@dataclass(frozen=True)
class Request:
    """What is asked for."""

    method: str
    query: dict[str, str]


def calm(_: Request) -> int:
    """Refuse nothing."""
    return 0


class Store:
    """A bucket called ``meshes``, and what was asked for."""

    bucket = "meshes"

    def __init__(self) -> None:
        self.weather: Callable[[Request], int] = calm
        """Says by which status a request is refused, if by any."""
        self.requests: list[Request] = []

    def __enter__(self) -> Store:
        # A bucket of the run before would be here, too.
        self._moto = DomainDispatcherApplication(create_backend_app)
        self._http = make_server("127.0.0.1", 0, self._answer, threaded=True)
        threading.Thread(target=self._http.serve_forever, daemon=True).start()
        self.endpoint = f"http://127.0.0.1:{self._http.port}"
        keys = {"aws_access_key_id": "key", "aws_secret_access_key": "secret", "region_name": "us-east-1"}
        self.client = boto3.client("s3", endpoint_url=self.endpoint, **keys)
        self.client.create_bucket(Bucket=self.bucket)
        return self

    def __exit__(self, *_: object) -> None:
        self._http.shutdown()
        self._http.server_close()

    @property
    def options(self) -> dict[str, Any]:
        """What obstore needs to find it."""
        return {
            "access_key_id": "key",
            "secret_access_key": "secret",
            "region": "us-east-1",
            "endpoint": self.endpoint,
            "client_options": {"allow_http": True},
        }

    @property
    def environment(self) -> dict[str, str]:
        """The same for processes."""
        return {
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ALLOW_HTTP": "true",
        }

    def put(self, key: str, data: bytes) -> None:
        self.client.put_object(Bucket=self.bucket, Key=key, Body=data)

    def get(self, key: str) -> bytes:
        return self.client.get_object(Bucket=self.bucket, Key=key)["Body"].read()

    def clear(self) -> None:
        """Remove all objects, in good weather, and forget all requests."""
        self.weather = calm
        for key in self.names():
            self.client.delete_object(Bucket=self.bucket, Key=key)
        self.requests.clear()

    def names(self) -> list[str]:
        """Names of all objects."""
        return [one["Key"] for one in self.client.list_objects_v2(Bucket=self.bucket).get("Contents", [])]

    def open_uploads(self) -> list[str]:
        """Names of what is neither complete nor dropped, and costs money."""
        return [
            one["Key"] for one in self.client.list_multipart_uploads(Bucket=self.bucket).get("Uploads", [])
        ]

    def _answer(self, environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        query = dict(parse_qsl(environ["QUERY_STRING"], keep_blank_values=True))
        request = Request(environ["REQUEST_METHOD"], query)
        self.requests.append(request)
        if not (status := self.weather(request)):
            return self._moto(environ, start)
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        start(f"{status} Refused", [("Content-Length", "0")])
        return [b""]
