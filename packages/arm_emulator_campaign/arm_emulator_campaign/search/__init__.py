"""Methods that choose the runs of a campaign from those before, instead of sampling them."""

from __future__ import annotations

from arm_emulator.extension.base import Section, require_package
from arm_emulator_campaign.sampling.variation import Variation
from arm_emulator_campaign.search.falsification import Bayes, CmaEs
from arm_emulator_campaign.search.method import Method
from arm_emulator_campaign.search.sensitivity import Morris, Sobol
from arm_emulator_campaign.search.splitting import Splitting
from arm_emulator_campaign.search.subset import Subset

METHODS: dict[str, type[Method]] = {
    method.kind: method for method in (CmaEs, Bayes, Sobol, Morris, Subset, Splitting)
}


def read_method(root: Section, variation: Variation) -> Method | None:
    """Return the method that a campaign's file names; None: its runs are sampled.

    Raises:
        Refusal: an unknown method or key, or a package that is not installed.
    """
    section = root.get_section("search")
    if section is None:
        return None
    kind = METHODS.get(name := section.read_text("method"))
    if kind is None:
        raise section.make_refusal("method", "be a known method", repr(name), ", ".join(METHODS))
    if root.has_key("count"):
        rule = "be absent together with search, which counts its runs"
        raise root.make_refusal("count", rule, "a count")
    of = section.read_text("of") if section.has_key("of") else ""
    requirements = root.get_section("requirements")
    names = [] if requirements is None else requirements.list_keys()
    if not names:
        raise section.make_refusal("method", "have a requirement to search for", "none")
    if of and (of not in names or kind.every):
        valid = "no `of`: it judges all" if kind.every else ", ".join(names)
        raise section.make_refusal("of", "name a requirement that is searched for", of, valid)
    method = kind(of=of, **section.read_numbers(kind))
    method.check_campaign(section, variation)
    section.refuse_unread_keys()
    if kind.package:
        require_package(f"{root.where}: search.method {name}", *kind.package)
    return method
