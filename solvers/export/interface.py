"""The parts of a controller's interface that depend on its motion and model, as C and Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from .layout import Layout


def numbers(values: Any) -> str:
    """Return numbers as C."""
    texts = {np.inf: "INFINITY", -np.inf: "-INFINITY"}
    return ", ".join(texts.get(float(each), repr(float(each))) for each in values)


def constants(layout: Layout, iterations: int) -> str:
    """Return sizes and places as C."""
    lines = [
        f"NAME_NX = {len(layout.state)}, /* state */", f"NAME_NU = {len(layout.control)}, /* torques */",
        f"NAME_JOINT_POSITION = {layout.positions}, /* place of the joints' angles in the state */",
        f"NAME_JOINT_VELOCITY = {layout.speeds}, /* place of the joints' speeds in the state */",
        f"NAME_MOST_ITERATIONS = {iterations} /* of a plan */",
    ]  # fmt: skip
    return "enum {\n" + "".join(f"    {line}\n" for line in lines) + "};"


def commands(layout: Layout) -> str:
    """Return the structure of the commands as C."""
    bits = ", ".join(f"NAME_{name.upper()} = {bit}" for name, bit in command_bits(layout).items())
    fields = "".join(f"    double {name};\n" for name in layout.commands)
    enum = f"enum {{ {bits} }};\n" if bits else ""
    if layout.motions:
        numbers = ", ".join(f"NAME_MOTION_{name.upper()}" for name in layout.motions)
        enum += (
            "/* The motions. The one that is asked for begins at the next boundary of phases where contacts allow. */\n"
            f"enum {{ {numbers}, NAME_MOTIONS }};\n"
        )
        fields += "    int motion;\n"
    told = f"typedef struct {{\n    unsigned set;\n{fields}}} NAME_commands;"
    return f"/* Commands. Those whose bit is in `set` change. */\n{enum}{told}"


def command_bits(layout: Layout) -> dict[str, int]:
    """Return the bit of each command."""
    return {name: 1 << i for i, name in enumerate([*layout.commands, *(["motion"] if layout.motions else [])])}


def command_code(layout: Layout) -> str:
    """Return the function that takes commands, as C."""
    lines = []
    for name in layout.commands:
        places = "".join(f" wanted[{at}] = commands->{name};" for at in layout.places[name])
        lines.append(
            f"    if (commands->set & NAME_{name.upper()}) {{\n"
            f"        if (!isfinite(commands->{name})) return NAME_BAD_COMMAND;\n       {places}\n    }}\n"
        )
    if layout.motions:
        lines.append(
            "    if (commands->set & NAME_MOTION) {\n"
            "        if (commands->motion < 0 || commands->motion >= NAME_MOTIONS) return NAME_BAD_COMMAND;\n"
            "        const double requests = floor(wanted[0] / NAME_MOTIONS) + 1.0; /* this one included */\n"
            "        wanted[0] = requests * NAME_MOTIONS + commands->motion;\n"
            "    }\n"
        )
    return (
        "int NAME_command(NAME *c, const NAME_commands *commands)\n{\n"
        "    if (!c || !commands) return NAME_BAD_ARGUMENT;\n"
        f"    if (commands->set & ~{sum(command_bits(layout).values())}u) return NAME_BAD_COMMAND;\n"
        "    double wanted[NUM_COMMANDS + 1];\n    memcpy(wanted, c->wanted, sizeof wanted);\n"
        f"{''.join(lines)}"
        "    memcpy(c->wanted, wanted, sizeof wanted);\n"
        "    memcpy(c->told[c->commands.back], wanted, sizeof wanted);\n    hand_over(&c->commands);\n"
        "    return NAME_OK;\n}"
    )


def fuzz_commands(layout: Layout) -> str:
    """Return statements that draw commands at random, as C."""
    return "".join(
        f"    commands.{name} = uniform(r) < 0.95 ? 4.0 * uniform(r) - 2.0 : uniform(r) < 0.5 ? NAN : 1e9;\n"
        for name in layout.commands
    ) + ("    commands.motion = (int)(uniform(r) * (NAME_MOTIONS + 0.1));\n" if layout.motions else "")


def outputs(layout: Layout) -> dict[str, str]:
    """Return the fields of an output that the model records, in C and Python, and the code that writes them."""
    declared, code, python, at = [], [], [], 0
    for path, unit, names in layout.recorded:
        field, size = path.replace(".", "_"), len(names)
        order = f" in the order {', '.join(names)};" if size <= 12 else ""
        told = f"{path} at these torques, world [{unit}];{order} 0 if damped"
        declared.append(f"    double {field}[{size}]; /* {told} */")
        code.append(f"    memcpy(out->{field}, did->recorded + {at}, sizeof out->{field});\n")
        python.append(f'("{field}", ct.c_double * {size}), ')
        at += size
    return {"RECORDED": "\n".join(declared), "RECORDED_CODE": "".join(code), "RECORDED_PYTHON": "".join(python)}


def contacts(measured: int) -> dict[str, str]:
    """Return the function that takes measured contact flags, if the low level measures contacts."""
    if not measured:
        return {"CONTACTS": "", "CONTACTS_CODE": "", "CONTACTS_WORDS": "", "CONTACTS_PYTHON": ""}
    head = f"int NAME_contacts(NAME *{{}}, const double flags[{measured}])"
    told = "/* Which feet are on the ground, 1 or 0, for the next ticks. The tick's thread. */\n"
    body = f"    memcpy(c->memory.readings, flags, sizeof(double) * {measured});\n"
    return {
        "CONTACTS": f"{told}{head.format('controller')};\n",
        "CONTACTS_WORDS": (
            "* `NAME_contacts(controller, flags)`, in the tick thread before `NAME_tick`, says which of the "
            f"{measured} feet are on the ground, 1 or 0, in the model's order. They stay until the next call; at "
            "first all are 0.\n"
        ),
        "CONTACTS_PYTHON": (
            "    def contacts(self, flags: Any) -> int:\n"
            '        """Say which feet are on the ground, for the next ticks."""\n'
            f"        return int(self.c.NAME_contacts(ct.c_void_p(self._at), (ct.c_double * {measured})(*flags)))\n\n"
        ),
        "CONTACTS_CODE": (
            f"{head.format('c')}\n{{\n    if (!c || !flags) return NAME_BAD_ARGUMENT;\n{body}    return NAME_OK;\n}}\n"
        ),
    }  # fmt: skip
