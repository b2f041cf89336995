"""Names of identifiers: terms of the field, verbs for functions, one class per name.

`make lint` runs this file. It prints figures per package and fails beyond the limits below, which
only move towards the aims: at most one name in 50 fails. `--list` prints each name that fails.
"""

import ast
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENDINGS = {".py", ".c", ".h", ".cpp", ".hpp"}
# A test is named after its claim: only the words of its names are judged.
CLAIMS = {"test", "examples"}
# (limit, aim); a figure may lie between them, not beyond the limit
FOREIGN = (0.6, 2.0)  # percent of names with a word that is no term of the field
NO_VERB = (2.5, 30.0)  # percent of functions whose name does not begin with a verb
NO_PREFIX = (1, 0)  # functions and properties of bool without is_, has_, can_
TWICE = (1, 20)  # class names that several modules define
WORDS = (2.1, 1.9)  # at least: mean number of words in the name of a function
C_NO_VERB = (23.5, 20.0)  # as above, of functions in C and C++
C_WORDS = (1.9, 1.9)
# A word that is no term of the field, and what to write instead.
INSTEAD = {
    "one": "joint, part, number, file", "other": "second, neighbour", "given": "argument, input",
    "kept": "stored, saved", "wanted": "expected, target", "turns": "lock", "stood": "was_immobile",
    "came": "arrived, received", "itself": "self_clocked", "hands": "controls", "desk": "server",
    "crew": "pool", "guest": "client", "laws": "controllers", "instructor": "executor",
    "way": "path", "ways": "paths", "sought": "identifiable", "wound": "wind_up",
    "wish": "setpoint", "held": "zoh", "standing": "inactive", "anyway": "watchdog",
    "anew": "again", "doubles": "duplicates", "precede": "priority", "lasting": "shared",
    "uncopied": "non_copyable", "known": "registry", "drawn": "sample", "usual": "regular",
    "nobody": "none", "glance": "sensor_input", "course": "schedule", "whole": "full, atomic",
    "slips": "mistakes", "doubts": "warnings", "intake": "subscriptions", "outbox": "publisher",
    "leader": "primal", "follower": "derivative", "judges": "evaluators", "needless": "duplicate",
    "answers": "commands, responses", "spread": "low_discrepancy", "subject": "run",
    "watched": "monitored", "attends": "poll", "heed": "handle", "perhaps": "hint",
    "found": "result", "got": "received", "made": "result", "most": "maximum",
    "least": "minimum", "seen": "visited", "gone": "removed", "shown": "text",
    "asked": "requested", "what": "quantity",
}  # fmt: skip
VERBS = set(
    """accelerate accept acquire activate add advance aim align allocate allow answer append apply
    approach approve arm arrange ask assemble assert attach attend average begin bend bind blend
    block boot bound brake break broadcast build bump calibrate call can cancel cap cast catch
    change check choose claim clamp clean clear clip clone close coerce collect combine command
    compare compensate compile complete compose compute configure connect consume contain continue
    convert copy correct count create cut damage deactivate decide declare decode delete deliver
    derive describe design destroy detach detect determine differentiate digest disable discard
    discretise dismiss displace divide do download drain draw drive drop dump edit eliminate emit
    enable encode end ensure enter enumerate escape estimate evaluate examine exchange execute exit
    expand expect explain export extend extract extrapolate factor fail fetch fill filter finalise
    find finish fit flatten flush fold follow force forget fork format free freeze gather generate
    get give go group grow guard guess halt handle has hash hide hold identify ignore import index
    infer inform init insert inspect install instruct integrate interpolate invert is iterate join
    judge jump keep kill launch leave let limit linearise link list listen load locate lock log look
    lower main make map mark match may measure merge mirror mix modify monitor move multiply name
    normalise note notify observe offer open order override pack pad parse pass pause perform
    permute place plan play plot poll pop post predict prepare preprocess press print probe process
    project propagate publish pull push put quantise query quit quote raise randomise rank reach
    read receive recompute record recover reduce refine reflect refresh refuse register reject
    release relink reload remember remove rename render reorder repair repeat replace replay report
    request require rescale reserve reset resolve respond restart restore resume retry retune return
    reverse rewind rotate round run sample save scale scan schedule search see select send serve set
    settle share shift shorten show shrink shut simulate size skip sleep slow smooth solve sort
    spawn spin split spoil stack start state step stop store strip submit subscribe subtract suggest
    sum suppress swap sweep switch synchronise synchronize take terminate test tick trace track
    transform translate transmit trigger truncate try tune turn undo unite unlock unpack unregister
    update upload use validate vary verify visit wait wake warm warn watch weigh withhold wrap write
    yield zero""".split()
)
# Further ones of functions in C and C++: of loops, conversions and physics.
C_VERBS = VERBS | set(
    """accumulate acknowledge adjust are attempt classify control enforce feed flip floor for halve
    interrupt invalidate latch meter negate pin prefetch pull resize rotate supply to transmit
    unwrap""".split()
)
OF_LIBRARIES = {"closed", "destroy_subscription", "beginning_execution"}  # which call these names
TYPE_LINE = re.compile(
    r"^[ \t]*(?:(?:static|inline|constexpr|extern|virtual|const|explicit|struct|class)\s+)*"
    r"(?:[A-Za-z_][\w:]*(?:<[^;(){}]*>)?[\s*&]+)([A-Za-z_]\w*)\s*(?=[({;=,\[])",
    re.M,
)
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"", re.S)
# A definition of a function: its type, name, parameters, and what stands before its body.
DEFINITION = re.compile(
    r"^[ \t]*(?:[\w:]+(?:<[^;{}()]*>)?(?:\([^()]*\))?[\s*&]+)+(?:\w+::)*([a-z]\w*)\s*"
    r"\(((?:[^;{}()]|\([^;{}()]*\)|\{\})*)\)([\s\w]*)(?:requires[^;{]*)?\{",
    re.M,
)
NO_CODE = re.compile(
    r"^[ \t]*#(?:[^\n]*\\\n)*[^\n]*|__attribute__\(\([^;{}]*?\)\)|\[\[\w+\]\]|extern\s*\{", re.M
)
NO_FUNCTIONS = {"alignas", "catch", "constexpr", "for", "if", "new", "requires", "switch", "while"}
STATEMENTS = {"return", "else", "delete", "throw", "using", "goto", "case", "new", "typedef"}


def words_of(name: str) -> list[str]:
    """Split a name at underscores and capitals."""
    return [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)]


class Figures:
    """Counts of one package."""

    def __init__(self) -> None:
        self.names: set[tuple[str, str]] = set()
        self.foreign: set[tuple[str, str]] = set()
        self.functions: list[str] = []
        self.no_verb: list[str] = []
        self.no_prefix: list[str] = []
        self.c_functions: list[str] = []
        self.c_no_verb: list[str] = []

    def add(self, file: str, name: str) -> None:
        """Count a name once per file."""
        if name.startswith("__") or len(name) < 2:
            return
        self.names.add((file, name))
        if any(word in INSTEAD for word in words_of(name)):
            self.foreign.add((file, name))

    def add_function(self, file: str, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        """Count a function and judge its name; properties need no verb."""
        if node.name.startswith("__") or not (words := words_of(node.name)):
            return
        decorators = {ast.unparse(decorator).split(".")[-1] for decorator in node.decorator_list}
        whether = isinstance(node.returns, ast.Name) and node.returns.id == "bool"
        is_property = bool(decorators & {"property", "cached_property", "setter"})
        # An action, which begins with a verb, may return whether it happened.
        is_exempt = node.name in OF_LIBRARIES or (words[0] in VERBS and not is_property)
        if whether and not is_exempt and words[0] not in ("is", "has", "can", "are", "was", "may"):
            self.no_prefix.append(f"{file}:{node.lineno} {node.name}")
        if "setter" in decorators:  # of a state, such as `plant.powered = False`
            entry = re.compile(rf"{re.escape(file)}:\d+ {node.name}")
            self.no_prefix = [name for name in self.no_prefix if not entry.fullmatch(name)]
        if is_property:
            return
        self.functions.append(node.name)
        if words[0] not in VERBS:
            self.no_verb.append(f"{file}:{node.lineno} {node.name}")

    def add_c_functions(self, file: str, text: str) -> None:
        """Count the functions that a file in C or C++ defines; constant accessors need no verb."""
        for definition in DEFINITION.finditer(NO_CODE.sub(" ", text)):
            name, parameters, after = definition.groups()
            words = words_of(name)
            is_accessor = parameters.strip() in ("", "void") and after.split()[:1] == ["const"]
            first = definition.group(0).split()[0]
            if is_accessor or first in STATEMENTS or name in NO_FUNCTIONS or name.endswith("_"):
                continue
            self.c_functions.append(name)
            # Functions with C linkage begin with their module, such as servo_ or drives_.
            has_prefix = not file.endswith(".hpp") or words[0] == "drives"
            if not C_VERBS & set(words if has_prefix else words[:1]):
                self.c_no_verb.append(f"{file} {name}")


def files() -> Iterator[tuple[str, Path]]:
    """Yield each tracked file that is checked, with its package."""
    for name in subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines():
        path, parts = ROOT / name, name.split("/")
        if path.suffix in ENDINGS and path.is_file():
            nested = len(parts) > 2 and parts[0] in ("arm_emulator", "packages")
            yield "/".join(parts[: 2 if nested else 1]), path


def check() -> tuple[dict[str, Figures], dict[str, set[str]]]:
    """Return the figures of each package and the modules of each class name."""
    figures: dict[str, Figures] = defaultdict(Figures)
    classes: dict[str, set[str]] = defaultdict(set)
    for package, path in files():
        file, text, counted = (
            str(path.relative_to(ROOT)),
            path.read_text(),
            figures[package],
        )
        if path.suffix != ".py":
            text = COMMENT.sub(" ", text)
            if not CLAIMS & set(file.split("/")):
                counted.add_c_functions(file, text)
            for kind in TYPE_LINE.finditer(text):
                if kind.group(0).split()[0] not in STATEMENTS:
                    counted.add(file, kind.group(1))
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                counted.add(file, node.name)
                if not CLAIMS & set(file.split("/")):
                    counted.add_function(file, node)
            elif isinstance(node, ast.ClassDef):
                counted.add(file, node.name)
                if not CLAIMS & set(file.split("/")):
                    classes[node.name].add(file)
            elif isinstance(node, ast.arg):
                counted.add(file, node.arg)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                counted.add(file, node.id)
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                counted.add(file, node.attr)
    return figures, classes


def main() -> int:
    """Print the figures; return 1 if any is beyond its limit."""
    figures, classes = check()
    everything = Figures()
    print(f"{'package':32} {'names':>6} {'foreign':>7} {'functions':>9} {'no verb':>7} {'bool':>5}")
    for package, counted in [*sorted(figures.items()), ("all", everything)]:
        print(
            f"{package:32} {len(counted.names):6} {len(counted.foreign):7}"
            f" {len(counted.functions):9} {len(counted.no_verb):7} {len(counted.no_prefix):5}"
        )
        everything.names |= counted.names
        everything.foreign |= counted.foreign
        for part in ("functions", "no_verb", "no_prefix", "c_functions", "c_no_verb"):
            if counted is not everything:
                getattr(everything, part).extend(getattr(counted, part))
    twice = {name for name, modules in classes.items() if len(modules) > 1}
    lengths = [len(words_of(name)) for name in everything.functions]
    c_lengths = [len(words_of(name)) for name in everything.c_functions]
    results = {
        "percent of names that are no terms of the field": (
            100 * len(everything.foreign) / len(everything.names), FOREIGN),
        "percent of functions without a verb": (
            100 * len(everything.no_verb) / len(everything.functions), NO_VERB),
        "functions of bool without is_, has_, can_": (len(everything.no_prefix), NO_PREFIX),
        "class names that several modules define": (len(twice), TWICE),
        "words in the name of a function": (sum(lengths) / len(lengths), WORDS),
        "percent of functions in C and C++ without a verb": (
            100 * len(everything.c_no_verb) / len(everything.c_functions), C_NO_VERB),
        "words in the name of a function in C or C++": (
            sum(c_lengths) / len(c_lengths), C_WORDS),
    }  # fmt: skip
    failed = False
    for quantity, (figure, (limit, aim)) in results.items():
        print(f"name_checker: {quantity}: {figure:.2f}, limit {limit}, aim {aim}")
        failed |= figure < limit if quantity.startswith("words") else figure > limit
    if failed or "--list" in sys.argv:
        counts = Counter(word for _, name in everything.foreign for word in words_of(name))
        for word, count in counts.most_common():
            if word in INSTEAD:
                print(f"{word}: {count} names; write {INSTEAD[word]}")
        print(
            "\n".join(
                [*everything.no_prefix, *everything.no_verb, *everything.c_no_verb, *sorted(twice)]
            )
        )
    return failed


if __name__ == "__main__":
    sys.exit(main())
