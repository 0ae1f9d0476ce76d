"""Marks and verifies a file with the client that was generated from openapi.yaml.

use.py PACKAGE-DIRECTORY BASE-URL HOST-FILE
"""

import hashlib
import io
import sys

directory, url, path = sys.argv[1:]
sys.path.insert(0, directory)

from quadmark_client import Client  # noqa: E402
from quadmark_client.api.inspections import inspect  # noqa: E402
from quadmark_client.api.verifications import get_verification, verify  # noqa: E402
from quadmark_client.api.watermarks import (  # noqa: E402
    embed,
    get_marked_file,
    get_watermark,
    list_watermarks,
    revoke_watermark,
)
from quadmark_client.models import (  # noqa: E402
    Code,
    Depth,
    EmbedForm,
    Format,
    InspectForm,
    Method,
    OnExisting,
    Order,
    Problem,
    Verdict,
    VerifyForm,
)
from quadmark_client.types import File  # noqa: E402

JSON = "application/json"
client = Client(base_url=url, timeout=120.0)
host = open(path, "rb").read()


def file(payload):
    return File(payload=io.BytesIO(payload), file_name="mesh.obj")


# A form, with a value of every kind.
form = EmbedForm(
    file=file(host),
    owner_id="acme",
    recipient="studio-7",
    method=Method.EXACT_MEAN,
    strength=0.15,
    bits=64,
    payload="0123456789abcdef",
    keep_file=True,
    on_existing=OnExisting.WARN,
)
made = embed.sync(client=client, body=form, accept=JSON, idempotency_key="k-1")
assert made.owner_id == "acme" and made.message == "0123456789abcdef", made
assert made.format_ == Format.OBJ and made.quality.method_used == Method.EXACT_MEAN, made
assert embed.sync(client=client, body=form, accept=JSON, idempotency_key="k-2") is not None

# The file, byte for byte.
marked = get_marked_file.sync(made.id, client=client).payload.read()
assert hashlib.sha256(marked).hexdigest() == made.marked_sha256
assert len(marked) == made.marked_bytes and marked != host

# Whose is it? As a form and as a raw body.
verdict = verify.sync(client=client, body=VerifyForm(file=file(marked), depth=Depth.STANDARD))
assert verdict.verdict == Verdict.MATCH and verdict.matches[0].watermark_id == made.id, verdict
raw = verify.sync(client=client, body=file(marked), owner_id="acme", depth=Depth.FAST)
assert raw.verdict == Verdict.MATCH, raw
assert get_verification.sync(verdict.id, client=client).matches[0].watermark_id == made.id
other = verify.sync(client=client, body=file(host))
assert other.verdict != Verdict.MATCH, other

# A raw body with its parameters in the query.
raw = embed.sync(client=client, body=file(host), owner_id="other", bits=32, accept=JSON)
assert raw.owner_id == "other" and raw.bits == 32, raw
seen = inspect.sync(client=client, body=InspectForm(file=file(host), bits=128))
assert seen.bits == 128 and seen.markable is not None, seen

# Pages and errors are typed, too.
page = list_watermarks.sync(client=client, order=Order.OLDEST, limit=1)
assert page.watermarks[0].id == made.id and page.resume_cursor, page
assert revoke_watermark.sync(made.id, client=client).revoked_at
assert get_watermark.sync(made.id, client=client).revoked_at
problem = embed.sync(client=client, body=form, accept=JSON, idempotency_key="k-1")
assert isinstance(problem, Problem) and problem.code == Code.IDEMPOTENCY_REVOKED, problem
problem = verify.sync(client=client, body=file(marked), owner_id="nobody")
assert isinstance(problem, Problem) and problem.code == Code.NOTHING_TO_COMPARE, problem
print("marked and verified")
