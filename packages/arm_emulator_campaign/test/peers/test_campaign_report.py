"""The report of a campaign on the screen of a phone."""

from pathlib import Path

from browser import chromium

from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.results.parts import Results, write_part
from arm_emulator_campaign.results.report import write_report
from arm_emulator_campaign.results.summary import compute_summary
from arm_emulator_campaign.simulation.batch_simulator import make_simulator
from arm_emulator_campaign.simulation.case import draw_cases
from arm_emulator_campaign.simulation.outcome import Outcomes

NARROW = 360  # px


def test_the_report_is_as_wide_as_a_phone(tmp_path):
    campaign = load_campaign(Path(__file__).parents[4] / "examples/campaign.yaml")
    results = Results(tmp_path, campaign)
    cases = draw_cases(campaign.variation, range(80))
    write_part(
        results.folder,
        campaign,
        Outcomes.join_outcomes(list(make_simulator(campaign).simulate_runs(cases))),
    )
    columns = results.collect_columns()
    file = write_report(campaign, results, columns, compute_summary(campaign, columns))
    with chromium() as browser:
        page = browser.new_page(viewport={"width": NARROW, "height": 740})
        page.goto(file.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") == NARROW
        pictures = page.evaluate("[...document.images].map(one => one.width)")
        assert len(pictures) == 3 and min(pictures) >= 700, "legible; they scroll in their frames"
