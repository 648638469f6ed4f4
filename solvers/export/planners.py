"""The parts of a controller that differ between one motion and several, as C and Python."""

from __future__ import annotations

from collections.abc import Sequence


def planner_values(motions: Sequence[str], first: int) -> dict[str, str]:
    """Return what the templates need of one motion, or of several.

    Args:
        motions: names of several motions; empty for one.
        first: number of the motion with which the controller begins.
    """
    return _several(motions, first) if motions else dict(_ONE)


_ONE = {
    "NUM_MOTIONS": "1", "AHEAD": "", "AHEAD_CODE": "", "DUE": "PERIOD + LATENCY", "NO_MOTION": "", "MOTION_CODE": "",
    "DUE_WORDS": "a period and the latency", "MOTION_NAMES": "", "MOTION_OUTPUT": "", "MOTION_DECLARED": "",
    "MOTION_PYTHON": "", "MOTIONS_PYTHON": "", "RESTARTED": "",
    "PLANNER_CODE": """Receding *NAME_planner(NAME *c, int motion) { return (void)motion, &c->memory.receding; }

int NAME_make(NAME *c, const double *x, double t, const Plan *plan)
{
    return receding_plan(&c->memory.receding, x, t, plan);
}

static void forget_plans(NAME *c)
{
    Receding *r = &c->memory.receding;
    r->has_plan = r->began = 0;
    r->clock.shift = r->clock.base = 0, r->clock.flight = -1, r->clock.late = 0.0;
}
""",
}  # fmt: skip


def _several(motions: Sequence[str], first: int) -> dict[str, str]:
    names = ", ".join(f'"{name}"' for name in motions)
    return {
        "NUM_MOTIONS": str(len(motions)),
        "AHEAD": "    struct place ahead; /* a plan that is made ahead of a change of the motion */\n",
        "AHEAD_CODE": "    place_plan(&c->ahead);\n    c->memory.motions.ahead = c->ahead.plan;\n",
        "DUE": "2.0 * PERIOD + LATENCY", "DUE_WORDS": "two periods and the latency",
        "NO_MOTION": "    out->motion = out->next_motion = -1;\n",
        "MOTION_CODE": "    out->motion = (int)p->header[MOTION], out->next_motion = (int)p->header[REQUEST];\n",
        "MOTION_OUTPUT": (
            "    int motion;             /* that of the plan, see NAME_motion_name; -1 if there is no plan */\n"
            "    int next_motion;        /* the one that is asked for and has not begun; else the same */\n"
        ),
        "MOTION_DECLARED": (
            "/* Name of a motion. */\nconst char *NAME_motion_name(int motion);\n"
        ),
        "MOTION_NAMES": (
            "\nconst char *NAME_motion_name(int motion)\n{\n"
            f"    static const char *const names[] = {{{names}}};\n"
            '    return motion >= 0 && motion < NUM_MOTIONS ? names[motion] : "none";\n}\n'
        ),
        "MOTION_PYTHON": '\n        ("motion", ct.c_int), ("next_motion", ct.c_int),',
        "MOTIONS_PYTHON": names,
        "RESTARTED": (
            "    Motions *m = &c->memory.motions;\n"
            "    m->seen = p[0], m->active = (int)p[1], m->home = (int)p[2], m->request = (int)p[3];\n"
            "    m->next = (int)p[4], m->entry = (int)p[5], m->made = (int)p[6], m->left = (int)p[7];\n"
            "    m->until = p[8], p += 9, active = m->active;\n"
            "    if (m->left >= 0) NAME_planner(c, m->left)->last = c->places[before].plan;\n"
            "    if (m->next >= 0) NAME_planner(c, m->next)->last = c->ahead.plan;\n"
        ),
        "PLANNER_CODE": f"""Receding *NAME_planner(NAME *c, int motion)
{{
    return c->memory.motions.motions[motion].planner;
}}

int NAME_make(NAME *c, const double *x, double t, const Plan *plan)
{{
    return motions_plan(&c->memory.motions, x, t, plan);
}}

static void forget_plans(NAME *c) {{ motions_reset(&c->memory.motions, {first}); }}
""",
    }  # fmt: skip
