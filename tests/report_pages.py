"""Pages to look at: scenes by hand, a page of everything, and a reader of pages."""

from __future__ import annotations

import base64
import io
import json
from html.parser import HTMLParser

import numpy as np

import trackrs as tr
from trackrs.report import Comparison, Curves, Interval, Line, MethodScore, Picture, Prose, Scene, Table, write_report

EVIL = '</script><img src=x onerror="window.evil = 1">&amp;<!--'
MOTION = tr.ConstantVelocity(dims=2, accel_psd=0.2)
RADAR = tr.PositionSensor(dims=2, std=[2.0, 3.0])
PNG = b"\x89PNG\r\n\x1a\n" + bytes(8)
SVG = b"""<svg xmlns="http://www.w3.org/2000/svg" width="40" height="40">
<rect width="40" height="40" style="fill:#ff0000"/></svg>"""


def tracks_of(means, times, ids, **more):
    """Tracks by hand: one row per time and id, scan by scan."""
    count, n = len(ids), means.shape[-1]
    covs = np.tile(np.diag(np.linspace(1.0, 4.0, n)) + 0.2, (len(times) * count, 1, 1))
    return tr.Tracks(
        scan_times=np.asarray(times, dtype=float),
        sensors=("radar",) * len(times),
        times=np.repeat(np.asarray(times, dtype=float), count),
        ids=np.tile(np.asarray(ids, dtype=np.uint64), len(times)),
        means=means.reshape(-1, n),
        covs=more.pop("covs", covs),
        last_hits=np.repeat(np.asarray(times, dtype=float), count),
        hits=np.repeat(np.arange(1, len(times) + 1, dtype=np.uint64), count),
        labels=more.pop("labels", ("x", "y", "vx", "vy")),
        offsets=np.arange(len(times) + 1) * count,
        **more,
    )


def course(scans, count, origin=(0.0, 0.0), seed=1):
    """Straight courses (scans, count, 4) from places within a kilometre of the origin."""
    rng = np.random.default_rng(seed)
    start, velocity = rng.uniform(-1000.0, 1000.0, (count, 2)), rng.uniform(-5.0, 5.0, (count, 2))
    positions = start + np.arange(scans)[:, None, None] * velocity + np.asarray(origin)
    return np.concatenate([positions, np.broadcast_to(velocity, positions.shape)], axis=2)


def scene_of(scans=30, count=3, detections=5, origin=(0.0, 0.0), **more):
    means, times = course(scans, count, origin), np.arange(float(scans))
    rng = np.random.default_rng(2)
    reports = [
        np.concatenate([row[:, :2], np.asarray(origin) + rng.uniform(-1000.0, 1000.0, (detections - count, 2))])
        for row in means
    ]
    return Scene(
        tracks_of(means, times, range(1, count + 1)),
        scans=[tr.Scan(time, rows, "radar") for time, rows in zip(times, reports, strict=True)],
        sensors={"radar": RADAR},
        motion=MOTION,
        truth=[tr.Truth(f"t{k}", times, means[:, k, :2]) for k in range(count)],
        **more,
    )


class Reader(HTMLParser):
    """Reads a page as a browser does: its elements, its texts, and that every element is closed."""

    VOID = frozenset({"meta", "link", "img", "input"})

    def __init__(self, page):
        super().__init__()
        self.open, self.tags, self.texts, self.bodies = [], [], [], {}
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in {"script", "style"}:
            key = self.tags[-1][1].get("type", self.open[-1])
            self.bodies[key] = self.bodies.get(key, "") + data
        else:
            self.texts.append(data)

    def all(self, tag, **wanted):
        return [attrs for name, attrs in self.tags if name == tag and all(attrs.get(k) == v for k, v in wanted.items())]

    @property
    def data(self):
        return json.loads(self.bodies["application/json"])


def page_of(*sections, title="Title", **more):
    file = io.StringIO()
    write_report(file, title, sections, **more)
    return file.getvalue()


def unpack(packed):
    ((kind, text),) = packed.items()
    return np.frombuffer(base64.b64decode(text), {"f32": "<f4", "f64": "<f8", "i32": "<i4"}[kind])


def every_section():
    rng = np.random.default_rng(4)
    times = np.arange(30.0)
    y = 5.0 + np.sin(times)
    lines = [Line("A", times, y, y - 1.0, y + 1.0), Line("B", times, rng.uniform(1, 9, 30))]
    claims = [["a", 1.23456, "holds"], ["b", None, "does not hold"], ["c", 7, "open"]]
    return [
        scene_of(title="Plane"),
        Curves(lines, title="Over time", y="OSPA (m)"),
        Comparison(
            [
                MethodScore("OSPA (m)", "ours", Interval(8.25, 7.9, 8.6)),
                MethodScore("OSPA (m)", "paper", Interval(10.0, 9.5, 10.5), Interval(1.75, 1.4, 2.1), 0.0004),
                MethodScore("time (ms)", "ours", Interval(3.0, np.nan, np.nan)),
            ],
            title="Methods",
            reference="ours",
        ),
        Table(["claim", "value", "verdict"], claims, "Claims", verdict="verdict"),
        Picture(SVG, "a red square", "Picture"),
        Prose("One.\n\nTwo.", "Words"),
    ]
