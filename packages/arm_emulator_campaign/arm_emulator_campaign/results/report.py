"""The report of a campaign: one HTML file with its pictures, which stand beside it as PNG too."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import escape_html, write_atomically
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.results import pictures
from arm_emulator_campaign.results.parts import (
    DIVERGED,
    FAILED,
    INDEX,
    ROBUSTNESS,
    Results,
    compute_digest,
    list_column_units,
)
from arm_emulator_campaign.results.summary import FailureRate, Summary
from arm_emulator_campaign.search.method import Finding

WORST = 12  # runs that are listed
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#22313f;max-width:1080px;margin:2.2em auto;
padding:0 1em;background:#fff}
h1{font-size:1.7em;margin:0}h2{font-size:1.15em;margin:2.2em 0 .5em;border-bottom:1px solid #dfe5ea;
padding-bottom:.25em}p.lead{color:#5b6b78;margin:.2em 0 1.4em}
.cards{display:flex;gap:14px;flex-wrap:wrap}.card{background:#f4f7f9;border-radius:8px;
padding:.7em 1.1em;min-width:110px}.card b{display:block;font-size:1.5em}.card.bad b{color:#d1495b}
.card.good b{color:#4878a8}.card span{color:#5b6b78;font-size:.86em}
table{border-collapse:collapse;width:100%;font-size:.92em}
th{text-align:left;color:#5b6b78;font-weight:600;border-bottom:2px solid #dfe5ea;padding:.35em .6em}
td{border-bottom:1px solid #eef2f4;padding:.35em .6em;vertical-align:top}
th{vertical-align:bottom}.n{text-align:right;font-variant-numeric:tabular-nums}td.n{white-space:nowrap}
td.bad{color:#d1495b;font-weight:600}code{background:#f4f7f9;border-radius:4px;padding:.1em .35em;
font-size:.9em}td code{word-break:break-word}img{max-width:100%;display:block;margin:.4em 0}
.bar{position:relative;height:10px;background:#eef2f4;border-radius:5px;min-width:150px;
margin-top:.45em}.bar i{position:absolute;top:0;bottom:0;background:#f0b9c1;border-radius:5px}
.bar b{position:absolute;top:-2px;bottom:-2px;width:3px;background:#d1495b}
.scroll{overflow-x:auto}.scroll td{white-space:nowrap}.scroll td code{word-break:normal}
.scroll img{min-width:720px}.scroll td.formula{min-width:11.5em;white-space:normal}
.formula code{display:inline-block;margin-top:.2em}
p code{overflow-wrap:anywhere}
footer{color:#8695a1;font-size:.85em;margin-top:3em}
"""


def write_report(
    campaign: Campaign,
    results: Results,
    columns: pictures.Columns,
    summary: Summary,
    findings: Sequence[Finding] = (),
) -> Path:
    """Write ``report.html`` and its pictures into the folder of the results; return the file.

    Args:
        campaign: which one.
        results: their folder.
        columns: all columns of these; without a run where the findings are of forks.
        summary: of these.
        findings: of a search.
    """
    varying = [number.name for number in campaign.variation.numbers]
    names = {f"{ROBUSTNESS}{name}": name for name in campaign.requirements}
    ranks = _rank_runs(columns, list(names))
    images: dict[str, bytes] = {}
    units = list_column_units(campaign)
    if names and summary.count:
        images["margins"] = pictures.encode_png(pictures.draw_margins(columns, names, units))
    if names and varying and summary.count:
        images["influences"] = pictures.encode_png(
            pictures.draw_influences(columns, varying, names, units)
        )
    if len(varying) > 1 and summary.count:
        order = _sort_by_influence(columns, varying, list(names))
        lines = pictures.draw_coordinates(columns, order, columns[FAILED], ranks)
        images["coordinates"] = pictures.encode_png(lines)
    for finding in findings:
        if finding.bars and finding.rows:
            images[finding.title.lower()] = pictures.encode_png(pictures.draw_finding(finding))
    for name, content in images.items():
        write_atomically(results.folder / f"{name}.png", content)
    file = results.folder / "report.html"
    text = "\n".join(_write_page(campaign, results, summary, columns, ranks, images, findings))
    write_atomically(file, text)
    return file


def _rank_runs(columns: pictures.Columns, names: Sequence[str]) -> NDArray[np.int64]:
    """Return the place of each run among the worst, by the requirement that it meets worst.

    Margins of different requirements have different units, so that only places compare.
    """
    if not names:
        return np.where(columns[FAILED], 0, 1)
    orders = [np.argsort(columns[name], kind="stable") for name in names]
    return np.asarray(np.min([np.argsort(order) for order in orders], axis=0))


def _sort_by_influence(
    columns: pictures.Columns, varying: Sequence[str], names: Sequence[str]
) -> list[str]:
    """Return the varied numbers, the strongest influence first."""
    strongest = dict.fromkeys(varying, 0.0)
    for of in names:
        for name, by in pictures.compute_influence(columns, varying, of).items():
            strongest[name] = max(strongest[name], abs(by))
    return sorted(varying, key=lambda name: -strongest[name])


def _write_page(
    campaign: Campaign,
    results: Results,
    summary: Summary,
    columns: pictures.Columns,
    ranks: NDArray[np.int64],
    images: dict[str, bytes],
    findings: Sequence[Finding],
) -> Iterable[str]:
    scenario, name = campaign.nominal[0], escape_html(campaign.file.stem)
    yield f"<!doctype html><html lang=en><meta charset=utf-8><title>{name}</title>"
    yield f"<meta name=viewport content='width=device-width'><style>{_STYLE}</style>"
    method = campaign.search
    of_all = "" if method else f"of {campaign.count} "
    runs = f"{summary.count} {of_all}runs" if summary.count else "Runs and forks of runs"
    yield f"<h1>{name}</h1><p class=lead>{runs} of the scene "
    yield f"<b>{escape_html(campaign.scene.name)}</b>, {scenario.seconds:g} s each; "
    how = f"searched by {method.kind}" if method else campaign.variation.sampling
    yield f"{len(campaign.variation.numbers)} numbers vary ({how})</p>"
    if summary.count:
        yield from _write_cards(campaign, summary, columns)
    for finding in findings:
        yield from _write_finding(finding)
    if summary.count:
        yield from _write_runs(campaign, results, summary, columns, ranks, images)
    yield f"<footer>campaign <code>{campaign.key.hex()[:16]}</code>, results "
    yield f"<code>{compute_digest(dict(columns))[:16]}</code></footer></html>"


def _write_cards(campaign: Campaign, summary: Summary, columns: pictures.Columns) -> Iterable[str]:
    method, scenario = campaign.search, campaign.nominal[0]
    yield "<div class=cards>"
    share = summary.shares[-1]
    kind = "bad" if share.hits else "good"
    if method:
        yield _write_card(str(share.hits), "runs fail", kind)
    else:
        yield _write_card(f"{100 * share.share:.3g} %", "of all runs fail", kind)
        percent = f"{100 * summary.confidence:g} % confidence"
        yield _write_card(f"{100 * share.low:.2g} to {100 * share.high:.2g} %", percent)
    yield _write_card(str(int(np.count_nonzero(np.isfinite(columns[DIVERGED])))), "diverged")
    yield _write_card(f"{summary.count * scenario.seconds:g} s", "simulated")
    yield "</div>"


def _write_runs(
    campaign: Campaign,
    results: Results,
    summary: Summary,
    columns: pictures.Columns,
    ranks: NDArray[np.int64],
    images: dict[str, bytes],
) -> Iterable[str]:
    yield from _write_requirements(campaign, summary)
    titles = {
        "sensitivity": "Sensitivity, drawn",
        "margins": "Margins",
        "influences": "What moves the margins",
        "coordinates": "All that varies, run by run",
    }
    for picture, content in images.items():
        data = base64.b64encode(content).decode()
        yield f"<h2>{titles[picture]}</h2><div class=scroll><img alt='{titles[picture]}' "
        yield f"src='data:image/png;base64,{data}'></div>"
    yield from _write_worst(campaign, columns, ranks)
    if campaign.search is None:
        yield from _write_quantiles(summary)


def _write_finding(finding: Finding) -> Iterable[str]:
    yield f"<h2>{escape_html(finding.title)}</h2><p>{escape_html(finding.about)}</p>"
    if not finding.rows:
        return
    words = [isinstance(entry, str) for entry in finding.rows[0]]
    kinds = ["" if word else " class=n" for word in words]
    yield "<div class=scroll><table><tr>"
    yield "".join(
        f"<th{kind}>{escape_html(head)}" for kind, head in zip(kinds, finding.head, strict=True)
    )
    yield "</tr>"
    for row in finding.format_rows():
        cells = zip(kinds, row, strict=True)
        yield "<tr>" + "".join(f"<td{kind}>{escape_html(entry)}" for kind, entry in cells) + "</tr>"
    yield "</table></div>"


def _write_card(value: str, text: str, kind: str = "") -> str:
    return f"<div class='card {kind}'><b>{escape_html(value)}</b><span>{text}</span></div>"


def _write_requirements(campaign: Campaign, summary: Summary) -> Iterable[str]:
    yield "<h2>Requirements</h2><div class=scroll><table><tr><th>must hold<th class=n>fails"
    sampled = campaign.search is None  # the share of runs that a search chose means nothing
    yield "<th class=n>share<th>confidence interval" if sampled else ""
    yield "<th class=n>least margin<th class=n>in run</tr>"
    scale = max([share.high for share in summary.shares] or [1.0])
    units = list_column_units(campaign)
    for share in summary.shares:
        definition = campaign.requirements.get(share.name, "")
        named = isinstance(definition, str) or "python" not in definition
        text = str(definition) if named else str(definition["python"])
        bad = " bad" if share.hits else ""
        yield f"<tr><td class=formula><b>{escape_html(share.name)}</b>"
        yield f"<br><code>{escape_html(text)}</code>" if text else ""
        yield f"<td class='n{bad}'>{share.hits}"
        yield (
            f"<td class=n>{100 * share.share:.3g} %<td>{_write_bar(share, scale)}"
            if sampled
            else ""
        )
        has_worst = share.worst >= 0
        unit = escape_html(units.get(f"{ROBUSTNESS}{share.name}", ""))
        yield f"<td class='n{bad}'>{share.least:.4g} {unit}" if has_worst else "<td>"
        yield f"<td class=n>{share.worst}</tr>" if has_worst else "<td></tr>"
    yield "</table></div>"


def _write_bar(failure_rate: FailureRate, scale: float) -> str:
    left, width = (
        100 * failure_rate.low / scale,
        100 * (failure_rate.high - failure_rate.low) / scale,
    )
    return (
        f"<div class=bar title='{100 * failure_rate.low:.4g} to {100 * failure_rate.high:.4g} %'>"
        f"<i style='left:{left:.2f}%;width:{width:.2f}%'></i>"
        f"<b style='left:{100 * failure_rate.share / scale:.2f}%'></b></div>"
        f"{100 * failure_rate.low:.3g} to {100 * failure_rate.high:.3g} %"
    )


def _write_worst(
    campaign: Campaign, columns: pictures.Columns, ranks: NDArray[np.int64]
) -> Iterable[str]:
    varying = [number.name for number in campaign.variation.numbers]
    margins = {f"{ROBUSTNESS}{name}": name for name in campaign.requirements}
    influential = _sort_by_influence(columns, varying, list(margins))[:5]
    units = list_column_units(campaign)
    command = f"arm_emulator campaign {shlex.quote(str(campaign.file))} --replay"
    yield "<h2>Worst runs</h2><p>The least margins of each requirement, in turns. This line prints "
    yield "the row of any run and records its motion:"
    yield f"<br><code>{escape_html(command)} INDEX --record run.mcap</code> or "
    yield "<code>--rerun run.rrd</code></p><div class=scroll><table><tr><th class=n>run"
    heads = {name: f"margin of {short}" for name, short in margins.items()}
    for name, head in (heads | {name: pictures.shorten_name(name) for name in influential}).items():
        unit = f" [{units[name]}]" if units[name] else ""
        yield f"<th class=n>{escape_html(head + unit)}"
    yield "<th>drive it again</tr>"
    for at in np.argsort(ranks, kind="stable")[:WORST]:
        index = int(columns[INDEX][at])
        yield f"<tr><td class='n{' bad' if columns[FAILED][at] else ''}'>{index}"
        for name in margins:
            margin = columns[name][at]
            yield f"<td class='n{'' if margin >= 0.0 else ' bad'}'>{margin:.4g}"
        yield "".join(f"<td class=n>{columns[name][at]:.4g}" for name in influential)
        line = f"{command} {index} --rerun run_{index}.rrd"
        yield f"<td><code>{escape_html(line)}</code></tr>"
    yield "</table></div>"


def _write_quantiles(summary: Summary) -> Iterable[str]:
    if not summary.quantiles:
        return
    heads = sorted({quantile.q for quantile in summary.quantiles})
    yield f"<h2>Quantiles</h2><p>Intervals of {100 * summary.confidence:g} % confidence; an end "
    yield "that so few runs do not have is open.</p><div class=scroll><table><tr><th>"
    yield "".join(f"<th class=n>{100 * q:g} %" for q in heads) + "</tr>"
    for column in dict.fromkeys(quantile.column for quantile in summary.quantiles):
        yield f"<tr><td>{escape_html(column)}"
        for quantile in (quantile for quantile in summary.quantiles if quantile.column == column):
            yield f"<td class=n>{quantile.value:.4g}<br><small>{quantile.interval}</small>"
        yield "</tr>"
    yield "</table></div>"
