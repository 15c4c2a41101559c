"""Datagrams: what is sent comes back; whatever else arrives is dropped, never raised."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware_bridge.protocols.datagrams import KINDS, decode, encode, numbers

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@given(st.sampled_from(sorted(KINDS)), st.dictionaries(st.text(max_size=8), JSON, max_size=5))
def test_what_is_sent_comes_back(kind, parts):
    message = {**parts, "kind": kind}
    assert decode(encode(message)) == message


@given(st.binary(max_size=200) | JSON.map(lambda value: json.dumps(value).encode()))
def test_other_bytes_are_no_message(data):
    message = decode(data)
    assert message is None or message["kind"] in KINDS


@pytest.mark.parametrize(
    "data", [b'{"kind": []}', b'{"kind": {}}', b'{"kind": null}', b'{"kind": "dance"}', b"[" * 50_000, b"9" * 5000]
)
def test_kinds_that_are_none_are_dropped(data):
    assert decode(data) is None


@given(JSON | st.lists(JSON, max_size=4), st.integers(0, 4))
def test_numbers_are_so_many_finite_ones_or_nothing(value, count):
    found = numbers(value, count)
    if found is not None:
        assert list(found) == [float(v) for v in value]
        assert len(found) == count


@pytest.mark.parametrize("value", [[10**400, 0], [float("nan"), 0], [float("inf"), 0], [True, 0], [1], "12", None])
def test_numbers_that_no_robot_can_use(value):
    assert numbers(value, 2) is None


def test_numbers_that_are_not_numbers_are_not_sent():
    with pytest.raises(ValueError, match="JSON"):
        encode({"kind": "set", "wheels": [float("nan"), 0.0]})
