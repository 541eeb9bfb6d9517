"""Queries about one scan as the projector's core receives and answers them, by number."""

from __future__ import annotations

from eigenscan.schemas.channels import Channel
from eigenscan.schemas.localize_pb2 import LocalizeQuery, LocalizeReply
from google.protobuf.wrappers_pb2 import StringValue

LOCALIZE_ASKED = Channel("localize", "asked/{query}", LocalizeQuery, about="a query on {site}/localize")
LOCALIZE_ANSWERED = Channel("localize_answered", "answered/{query}", LocalizeReply, about="its answer")
LOCALIZE_REFUSED = Channel("localize_refused", "refused/{query}", StringValue, about="why there is none")
