"""What is said of failures, outages and recovery that cannot be: a table of mistakes, one a line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.planted import rows
from tests.twin.operations.operated import STACK
from tests.twin.program import invoke
from tests.twin.scenarios.test_processes import SCENARIO as COVER
from tests.twin.written import loaded, refusal, written

WRONG = rows(r"""
cell  | section                                                        | at       | says
stack | outages: [{robot: lefd, at_s: 1}]                              | lefd     | unknown robot 'lefd'; did you mean 'left'? (valid: left, right)
stack | outages: [{robot: left, at_s: 1}, {robot: left, at_s: 5}]      | left, at_s: 5 | left is out for good by another entry already: leave one out
stack | outages: [{robot: left, at_s: -1}]                             | -1       | must be at least 0, not -1
stack | outages: [{robot: left, at_s: 1e12}]                           | 1e12     | must be at most 1e+06
stack | outages: [{robot: left, at_s: .nan}]                           | .nan     | a finite number expected
stack | outages: [{robot: left}]                                       | {robot   | key 'at_s' is missing
stack | outages: [{robot: left, at_s: 5, for_s: 3}]                    | for_s    | unknown key 'for_s' (valid: robot, at_s)
stack | outages: {robot: left, at_s: 5}                                | {robot   | a list [..] expected, not a mapping
stack | late: [{part: left_x, at_s: 4}]                                | left_x   | unknown part 'left_x'; did you mean 'left_
stack | late: [{part: left_a, at_s: 4}, {part: left_a, at_s: 9}]       | left_a, at_s: 9 | left_a comes at another time by another entry: leave one out
stack | late: [{part: left_a, at_s: -4}]                               | -4       | must be at least 0
stack | late: [{part: left_a}]                                         | {part    | key 'at_s' is missing
stack | changes: [{at_s: 4, drop: [2, 5]}]                             | 5        | there is no step 5 (valid: 1 to 4)
stack | changes: [{at_s: 4, drop: [2]}, {at_s: 5, drop: [2]}]          | 2]}]     | step 2 is dropped already: leave it out
stack | changes: [{at_s: 4, drop: []}]                                 | {at_s    | what is ordered differently? Give drop
stack | changes: [{at_s: 4, drop: [3], add: [2]}]                      | add      | unknown key 'add' (valid: more)
stack | changes: [{at_s: 4, more: 2}]                                  | 2        | 2 more than there are parts for: assembly.products.spare must be at least 2
stack | failures: {pik: {probability: 0.1}}                            | pik      | unknown skill 'pik'; did you mean 'pick'? (valid: pick, place-down
stack | failures: {transit: {probability: 0.1}}                        | transit  | unknown skill 'transit' (valid: pick, place-down
stack | failures: {pick: 0.1}                                          | 0.1      | a mapping (key: value) expected, not 0.1
stack | failures: {pick: {probability: 1.5}}                           | 1.5      | must be at most 1, not 1.5
stack | failures: {pick: {probability: often}}                         | often    | a number expected, not 'often'
stack | failures: {pick: {retries: 2}}                                 | {retries | key 'probability' is missing
stack | failures: {pick: {probability: 0.1, retries: 1.5}}             | 1.5      | a whole number expected, not 1.5
stack | failures: {pick: {probability: 0.1, loses: 2}}                 | 2}}      | must be at most 1, not 2
stack | failures: {pick: {probability: 0.1, slips: 0.2}}               | 0.2      | nothing is in the hand before pick
stack | failures: {place-down: {probability: 0.1, wrong: 0.2}}         | 0.2      | no wrong part is found in place-down: leave it out (valid: pick)
stack | failures: {pick: {probability: 0.1, then: scrap}}              | scrap    | pick is no process
stack | failures: {pick: {probability: 0.1, lose: 0.2}}                | lose     | unknown key 'lose'; did you mean 'loses'?
stack | failures: {support-top: {probability: 0.1, loses: 0.2}}        | 0.2      | nothing can be lost in support-top, in which nothing changes hands: leave it out (valid: pick, place-down, place-up, handover)
stack | failures: {pick: {probability: 0.1, retry: {kind: fixd, value_s: 1}}} | fixd | unknown kind 'fixd'; did you mean 'fixed'? (valid: empirical
stack | failures: {pick: {probability: 0.1, parts: {peg: 0.1}}}        | peg      | unknown part 'peg' (valid: left_a, left_b
cover | failures: {pick: {probability: 0.1, parts: {covr: 0.1}}}       | covr     | unknown part 'covr'; did you mean 'cover'? (valid:
cover | failures: {pick: {probability: 0.1, parts: {wright/cover: 0.1}}} | wright/cover | unknown robot 'wright'; did you mean 'right'? (valid:
cover | failures: {pick: {probability: 0.1, parts: {cover: 7}}}        | 7        | must be at most 1, not 7
cover | failures: {seel: {probability: 0.1}}                           | seel     | unknown skill 'seel'; did you mean 'seal'? (valid: pick
cover | failures: {seal: {probability: 0.1, loses: 0.5}}               | 0.5      | nothing can be lost in seal
stack | recovery: {planning_s: -1}                                     | -1       | must be at least 0, not -1
stack | recovery: {planning: 1}                                        | planning | unknown key 'planning': this quantity is in seconds, as 'planning_s'
stack | recovery: {ask: {answer_s: -1}}                                | -1       | must be at least 0
stack | recovery: {ask: {answer_s: 5, answer: {kind: fixed, value_s: 3}}} | {answer_s | give answer_s or answer, not both
stack | recovery: {ask: {helps: 1.2}}                                  | 1.2      | must be at most 1, not 1.2
stack | recovery: {ask: {times: 0}}                                    | 0}}      | must be at least 1, not 0
stack | recovery: {ask: yes}                                           | yes      | a mapping (key: value) expected
stack | recovery: {again: 2.5}                                         | 2.5      | a whole number expected, not 2.5
stack | recovery: {remove_s: 1e9}                                      | 1e9      | must be at most 3600
stack | recovery: {bin: person}                                        | person   | a bin is for assemblies of parts that are planned step by step: leave it out
stack | recovery: 3                                                    | 3        | a mapping (key: value) expected, not 3
""")


def with_section(cell: str, section: str) -> str:
    """Return the text of a cell with a section of execution."""
    text = {"stack": STACK + "execution:\n", "cover": COVER}[cell]
    assert text.count("execution:\n") == 1
    return text.replace("execution:\n", f"execution:\n  {section}\n")


@pytest.mark.parametrize(("cell", "section", "at", "says"), WRONG)
def test_what_cannot_go_wrong_is_said(
    tmp_path: Path, cell: str, section: str, at: str, says: str
) -> None:
    text = with_section(cell, section)
    found = refusal(tmp_path, text)
    (problem,) = found.problems
    assert says in problem.message
    (row,) = [k for k, line in enumerate(text.splitlines()) if section in line]
    assert problem.mark.line == row + 1
    assert problem.mark.column == 3 + section.rindex(at)
    assert found.headline(problem) in str(found)


def test_what_can_go_wrong_is_read(tmp_path: Path) -> None:
    for cell in ("stack", "cover"):
        section = "failures: {pick: {probability: 0.1, loses: 0.2}}"
        own = loaded(tmp_path, with_section(cell, section)).execution
        assert own.failures["pick"].loses == 0.2


def test_the_program_refuses_before_it_plans(tmp_path: Path) -> None:
    file = written(tmp_path, with_section("stack", "outages: [{robot: lefd, at_s: 1}]"))
    for command in ("operate", "check", "run"):
        result = invoke(command, file, code=2)
        assert "unknown robot 'lefd'" in result.output
