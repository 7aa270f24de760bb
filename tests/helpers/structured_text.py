"""Structured Text run: read by a grammar of others, checked strictly, and compiled by way of C.

No open toolchain for Structured Text can be installed by a package manager here. So the text is
parsed by tree-sitter's grammar of IEC 61131-3 (edition 3), held to the rules below, which are those
of the strictest systems, and translated to C word for word, where every index is held to its
bounds.

- every name is declared once in its unit, whatever its case; none is a word of the language or of
  a standard function, none has two underscores in a row, and none is longer than 63 characters;
- nothing is converted unseen: both sides of an operator and of an assignment have the same type;
- an index is a DINT, a condition a BOOL, and a literal beside a real number has its type;
- constants and inputs are not assigned, nor is the variable of a loop inside it;
- arrays have one dimension, as many initial values as elements, and are not assigned whole.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass, field

import pytest

from estimator.export.structured_text import st_files

#: No name may be one: words of ST and Instruction List, types, standard functions and blocks.
_WORDS = """
    ABS ACOS ACTION ADD AND ANDN ANY ARRAY ASIN AT ATAN BOOL BY BYTE CAL CASE CONCAT
    CONFIGURATION CONSTANT COS CTD CTU CTUD DATE DELETE DINT DIV DO DT DWORD ELSE ELSIF EN
    END_IF ENO EQ EXIT EXP EXPT F_EDGE F_TRIG FALSE FIND FOR FROM FUNCTION GE GT IF
    INITIAL_STEP INSERT INT INTERFACE JMP LD LE LEFT LEN LIMIT LINT LN LOG LREAL LT LWORD
    MAX METHOD MID MIN MOD MOVE MUL MUX NE NON_RETAIN NOT OF ON OR ORN PRIORITY PROGRAM PT
    PV R R_EDGE R_TRIG READ_ONLY READ_WRITE REAL REPEAT REPLACE RESOURCE RET RETAIN RETURN
    RIGHT ROL ROR RS RTC S SEL SHL SHR SIN SINGLE SINT SQRT SR ST STEP STN STRING STRUCT SUB
    SUPER TAN TASK THEN THIS TIME TO TOD TOF TON TP TRANSITION TRUE TRUNC TYPE UDINT UINT
    ULINT UNTIL USINT VAR WHILE WITH WORD WSTRING XOR XORN
"""
RESERVED = frozenset(_WORDS.split())
#: Standard functions of one real argument that gives one of the same type, and their names in C.
REAL_FUNCTIONS = {"ABS": "fabs", "SQRT": "sqrt", "EXP": "exp", "LN": "log", "SIN": "sin"}
REAL_FUNCTIONS |= {"COS": "cos"}
CONVERSIONS = {
    "DINT_TO_LREAL": ("DINT", "LREAL"),
    "DINT_TO_REAL": ("DINT", "REAL"),
    "REAL_TO_LREAL": ("REAL", "LREAL"),
    "LREAL_TO_DINT": ("LREAL", "DINT"),
    "REAL_TO_DINT": ("REAL", "DINT"),
}
C_TYPES = {
    "LREAL": "double",
    "REAL": "float",
    "DINT": "int32_t",
    "BOOL": "_Bool",
    "WORD": "uint16_t",
}
REALS = ("LREAL", "REAL")
UNITS = ("function_declaration", "function_block_declaration", "program_declaration")
COMMENTS = ("comment", "block_comment")
ARITHMETIC, COMPARISONS = {"+", "-", "*", "/"}, {"<", "<=", ">", ">=", "=", "<>"}


@dataclass(frozen=True)
class Typed:
    """An expression in C and its type in Structured Text; an array has how many elements it has."""

    text: str
    type: str
    size: int = 0


@dataclass
class Unit:
    """A function, function block or program."""

    name: str
    kind: str
    variables: dict[str, Variable] = field(default_factory=dict)


@dataclass(frozen=True)
class Variable:
    """A variable of a unit; its section is input, output, inout, constant or own."""

    name: str
    type: str
    size: int
    section: str
    initial: tuple[str, ...]


def parsed(text):
    """The syntax tree by a grammar of others; an error of it fails."""
    tree_sitter = pytest.importorskip("tree_sitter", reason="needs tree-sitter")
    grammar = pytest.importorskip(
        "tree_sitter_iec61131_3_st", reason="needs tree-sitter-iec61131-3-st"
    )
    parser = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
    root = parser.parse(text.encode()).root_node
    if root.has_error:
        raise AssertionError(f"the grammar refuses {first_error(root)}")
    return root


def first_error(node):
    """Where the grammar stops."""
    for child in node.children:
        if child.has_error:
            return first_error(child)
    return f"line {node.start_point[0] + 1}: {node.text.decode()[:80]}"


def text_of(node):
    return node.text.decode()


def named(node, name):
    return node.children_by_field_name(name)


class Translator:
    """From the syntax tree of a whole program to C; see the module for the rules."""

    def __init__(self):
        self.units, self.types, self.output = {}, {}, []
        self.unit, self.loops = None, []

    def fail(self, node, message):
        raise AssertionError(f"line {node.start_point[0] + 1}: {message}: {text_of(node)[:80]}")

    def program(self, root):
        for node in root.named_children:
            if (
                node.type in ("function_declaration", "function_block_declaration")
                or node.type == "program_declaration"
            ):
                self.declared(node)
            elif node.type == "type_declaration":
                self.named_types(node)
            elif node.type not in (*COMMENTS, "empty_statement"):
                self.fail(node, f"unknown {node.type}")
        return "\n".join(self.output)

    def check_name(self, node, taken):
        name = text_of(node)
        upper = name.upper()
        good = re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name) and len(name) <= 63
        if not good or upper in RESERVED or upper in taken:
            self.fail(node, "not a name, a reserved one, or one that is taken")
        return name

    def named_types(self, node):
        for one in node.named_children:
            if one.type not in COMMENTS:
                name = self.check_name(named(one, "name")[0], self.types)
                self.types[name.upper()] = self.type_of(named(one, "definition")[0])

    def type_of(self, node):
        """(type, size); size 0 for what is not an array."""
        if node.type == "array_type":
            [span] = named(node, "range")
            low, high = (int(text_of(named(span, end)[0])) for end in ("lower", "upper"))
            element, inner = self.type_of(named(node, "element_type")[0])
            if low != 0 or high < 0 or inner:
                self.fail(node, "an array from 0, of what is not an array")
            return element, high + 1
        name = text_of(node).upper()
        if name in C_TYPES:
            return name, 0
        if name in self.types:
            return self.types[name]
        if name in self.units and self.units[name].kind == "function_block":
            return name, 0
        return self.fail(node, "unknown type")

    def declared(self, node):
        kind = node.type.removesuffix("_declaration")
        name = self.check_name(named(node, "name")[0], self.units)
        unit = self.unit = Unit(name, kind)
        returned = named(node, "return_type")
        result = self.type_of(returned[0])[0] if returned else None
        body = named(node, "body")
        for block in node.named_children:
            if block.type.startswith("var_"):
                self.variables(block)
        if kind == "function":
            unit.variables[name.upper()] = Variable(name, result, 0, "own", ())
        statements = "\n".join(self.statement(one) for one in body)
        self.units[name.upper()] = unit
        (self.function if kind == "function" else self.block)(unit, statements, result)

    def variables(self, block):
        section = {"var_input": "input", "var_output": "output", "var_in_out": "inout"}.get(
            block.type, "own"
        )
        for one in block.named_children:
            if one.type == "var_qualifier_list":
                if text_of(one).upper() != "CONSTANT":
                    self.fail(one, "unknown qualifier")
                section = "constant"
            elif one.type == "variable_declaration":
                element, size = self.type_of(named(one, "type")[0])
                initial = self.initial(one, element, size)
                for name in named(one, "names"):
                    if name.type != "identifier":
                        continue
                    spelled = self.check_name(name, self.unit.variables)
                    if spelled.upper() in self.units:
                        self.fail(name, "the name of a unit")
                    self.unit.variables[spelled.upper()] = Variable(
                        spelled, element, size, section, initial
                    )
            elif one.type not in COMMENTS:
                self.fail(one, f"unknown {one.type}")

    def initial(self, node, element, size):
        values = [one for one in named(node, "initial_value") if one.is_named]
        if not values:
            return ()
        if len(values) != max(size, 1):
            self.fail(node, f"{len(values)} initial values for {size} elements")
        found = []
        for one in values:
            if element in REALS and one.type in ("real_literal", "unary_expression"):
                found.append(self.real(one, element))
            else:
                found.append(self.expression(one, element).text)
        return tuple(found)

    def real(self, node, kind):
        text = text_of(node)
        if not re.fullmatch(r"-?\d+\.\d+(E[+-]?\d+)?", text):
            self.fail(node, "a real literal has a point, and digits on both of its sides")
        return text + ("f" if kind == "REAL" else "")

    # Expressions

    def expression(self, node, wanted=None):
        found = getattr(self, f"on_{node.type}", None)
        if found is None:
            self.fail(node, f"unknown {node.type}")
        result = found(node)
        if wanted is not None and result.type != wanted:
            self.fail(node, f"{result.type}, not {wanted}")
        return result

    def on_identifier(self, node):
        name = text_of(node).upper()
        variable = self.unit.variables.get(name)
        if variable is None:
            self.fail(node, "not declared")
        return Typed(self.place(variable), variable.type, variable.size)

    def place(self, variable):
        name = f"v_{variable.name.lower()}"
        if variable.section == "constant":
            return f"{self.unit.name.lower()}_{name}"
        if self.unit.kind == "function":
            return name
        return f"self->{name}"

    def on_index_expression(self, node):
        array = self.expression(named(node, "object")[0])
        [at] = [self.expression(one, "DINT") for one in named(node, "index") if one.is_named]
        if not array.size:
            self.fail(node, "no array")
        return Typed(f"{array.text}[within({at.text}, {array.size}, __LINE__)]", array.type)

    def on_member_access_expression(self, node):
        *_, object_, member = node.named_children
        instance = self.expression(object_)
        unit = self.units.get(instance.type)
        variable = unit and unit.variables.get(text_of(member).upper())
        if variable is None or variable.section != "output":
            self.fail(node, "no output")
        return Typed(f"{instance.text}.v_{variable.name.lower()}", variable.type, variable.size)

    def on_integer_literal(self, node):
        if not re.fullmatch(r"-?\d+", text_of(node)):
            self.fail(node, "an integer without a type is a decimal one")
        return Typed(text_of(node), "DINT")

    def on_boolean_literal(self, node):
        return Typed({"TRUE": "1", "FALSE": "0"}[text_of(node).upper()], "BOOL")

    def on_typed_literal(self, node):
        kind, _, value = text_of(node).partition("#")
        if kind in REALS:
            if not re.fullmatch(r"-?\d+\.\d+(E[+-]?\d+)?", value):
                self.fail(node, "a real literal has a point")
            return Typed(f"({value}{'f' if kind == 'REAL' else ''})", kind)
        if kind == "WORD" and re.fullmatch(r"16#[0-9A-F]{4}", value):
            return Typed(f"(uint16_t)0x{value[3:]}", kind)
        return self.fail(node, "unknown literal")

    def on_real_literal(self, node):
        return self.fail(node, "a literal in an expression has its type")

    def on_parenthesized_expression(self, node):
        [inner] = node.named_children
        found = self.expression(inner)
        return Typed(f"({found.text})", found.type)

    def on_unary_expression(self, node):
        inner = self.expression(named(node, "operand")[0])
        sign = text_of(node.children[0]).upper()
        if sign == "NOT" and inner.type == "BOOL":
            return Typed(f"(!{inner.text})", "BOOL")
        if sign == "-" and inner.type in (*REALS, "DINT"):
            return Typed(f"(-{inner.text})", inner.type)
        return self.fail(node, "no such sign")

    def on_binary_expression(self, node):
        left, right = (self.expression(named(node, side)[0]) for side in ("left", "right"))
        [sign] = [text_of(one).upper() for one in node.children if not one.is_named]
        if left.type != right.type or left.size or right.size:
            self.fail(node, f"{left.type} {sign} {right.type}")
        kind = left.type
        if sign in ARITHMETIC and kind in (*REALS, "DINT"):
            # In Structured Text, too, what stands on the left is done first.
            return Typed(f"({left.text} {sign} {right.text})", kind)
        if sign in ("DIV", "MOD") or (sign == "/" and kind == "DINT"):
            return Typed(f"({left.text} {'%' if sign == 'MOD' else '/'} {right.text})", kind)
        if sign in COMPARISONS:
            in_c = {"=": "==", "<>": "!="}.get(sign, sign)
            return Typed(f"({left.text} {in_c} {right.text})", "BOOL")
        if sign in ("AND", "OR") and kind == "BOOL":
            # Both sides are worked out.
            return Typed(f"(_Bool)({left.text} {'&' if sign == 'AND' else '|'} {right.text})", kind)
        if sign in ("AND", "OR") and kind == "WORD":
            in_c = "&" if sign == "AND" else "|"
            return Typed(f"(uint16_t)({left.text} {in_c} {right.text})", kind)
        return self.fail(node, f"{kind} {sign}")

    def on_call_expression(self, node):
        name = text_of(named(node, "function")[0]).upper()
        given = named(node, "arguments")[0].named_children
        if name in CONVERSIONS:
            source, target = CONVERSIONS[name]
            [one] = [self.expression(value, source) for value in given]
            # To the nearest integer.
            value = f"lrint({one.text})" if target == "DINT" else one.text
            return Typed(f"({C_TYPES[target]})({value})", target)
        values = [self.expression(one) for one in given]
        kinds = {one.type for one in values}
        if name in {*REAL_FUNCTIONS, "EXPT"} and kinds <= set(REALS) and len(kinds) == 1:
            kind = values[0].type
            in_c = REAL_FUNCTIONS.get(name, "pow") + ("f" if kind == "REAL" else "")
            return Typed(f"{in_c}({', '.join(one.text for one in values)})", kind)
        unit = self.units.get(name)
        if unit is None or unit.kind != "function":
            self.fail(node, "unknown function")
        inputs = [one for one in unit.variables.values() if one.section == "input"]
        if [one.type for one in inputs] != [one.type for one in values]:
            self.fail(node, "arguments of another type")
        result = unit.variables[name].type
        return Typed(f"{unit.name.lower()}({', '.join(one.text for one in values)})", result)

    # Statements

    def statement(self, node):
        found = getattr(self, f"do_{node.type}", None)
        if found is None:
            self.fail(node, f"unknown {node.type}")
        return f"#line {node.start_point[0] + 1}\n{found(node)}"

    def statements(self, nodes):
        return "\n".join(self.statement(one) for one in nodes if one.is_named)

    def do_empty_statement(self, _):
        return ";"

    def do_comment(self, _):
        return ""

    do_block_comment = do_comment

    def do_assignment_statement(self, node):
        target = named(node, "left")[0]
        base = target
        while base.type == "index_expression":
            [base] = named(base, "object")
        variable = self.unit.variables.get(text_of(base).upper())
        if variable is None or variable.section in ("constant", "input"):
            self.fail(node, "what is assigned is a variable of its own")
        if variable.name.upper() in self.loops:
            self.fail(node, "the variable of a loop is assigned in it")
        left = self.expression(target)
        if left.size:
            self.fail(node, "an array is not assigned whole")
        right = self.expression(named(node, "right")[0], left.type)
        return f"{left.text} = {right.text};"

    def do_if_statement(self, node):
        condition = self.expression(named(node, "condition")[0], "BOOL")
        text = f"if ({condition.text}) {{\n{self.statements(named(node, 'consequence'))}\n}}"
        for one in node.named_children:
            if one.type == "elsif_clause":
                condition = self.expression(named(one, "condition")[0], "BOOL")
                text += f" else if ({condition.text}) {{\n{self.statements(named(one, 'body'))}\n}}"
            elif one.type == "else_clause":
                text += f" else {{\n{self.statements(named(one, 'body'))}\n}}"
        return text

    def do_for_statement(self, node):
        [control] = named(node, "control")
        variable = self.expression(control, "DINT")
        start, end = (self.expression(named(node, one)[0], "DINT") for one in ("start", "end"))
        step = named(node, "step")
        by = int(text_of(step[0])) if step else 1
        name = text_of(control).upper()
        if name in self.loops:
            self.fail(node, "a loop inside a loop has its own variable")
        self.loops.append(name)
        body = self.statements(named(node, "body"))
        self.loops.pop()
        v = variable.text
        sign = "<=" if by > 0 else ">="
        return f"for ({v} = {start.text}; {v} {sign} {end.text}; {v} += {by}) {{\n{body}\n}}"

    def do_while_statement(self, node):
        condition = self.expression(named(node, "condition")[0], "BOOL")
        return f"while ({condition.text}) {{\n{self.statements(named(node, 'body'))}\n}}"

    def do_exit_statement(self, node):
        if not self.loops:
            self.fail(node, "no loop")
        return "break;"

    def do_return_statement(self, _):
        return "goto done;"

    def do_invocation_statement(self, node):
        [call] = [one for one in node.named_children if one.type == "call_expression"]
        instance = self.expression(named(call, "function")[0])
        unit = self.units.get(instance.type)
        if unit is None:
            self.fail(node, "no function block")
        lines, inouts, given = [], {}, set()
        for one in named(call, "arguments")[0].named_children:
            if one.type in COMMENTS:
                continue
            name = text_of(named(one, "name")[0]).upper()
            variable = unit.variables.get(name)
            if variable is None or variable.section not in ("input", "inout") or name in given:
                self.fail(one, "no input")
            given.add(name)
            value = self.expression(named(one, "value")[0], variable.type)
            if variable.section == "inout":
                if value.size != variable.size:
                    self.fail(one, "an array of another size")
                inouts[name] = value.text
            else:
                lines.append(f"{instance.text}.v_{variable.name.lower()} = {value.text};")
        wanted = [key for key, one in unit.variables.items() if one.section == "inout"]
        if set(wanted) != set(inouts):
            self.fail(node, "an in-out variable is not given")
        lines += [f"{instance.text}.v_{key.lower()} = {inouts[key]};" for key in wanted]
        return "\n".join([*lines, f"{unit.name.lower()}(&{instance.text});"])

    # Units

    def block(self, unit, statements, _):
        name, members, begun = unit.name.lower(), [], []
        for one in unit.variables.values():
            v, kind = f"v_{one.name.lower()}", C_TYPES.get(one.type, f"{one.type.lower()}_t")
            size = f"[{one.size}]" if one.size else ""
            if one.section == "constant":
                values = ", ".join(one.initial)
                self.output.append(f"static const {kind} {name}_{v}{size} = {{{values}}};")
                continue
            members.append(
                f"{kind} {'*' if one.section == 'inout' else ''}{v}"
                f"{'' if one.section == 'inout' else size};"
            )
            if one.initial:
                [value] = one.initial
                begun.append(f"self->{v} = {value};")
            elif one.type not in C_TYPES:
                begun.append(f"begin_{one.type.lower()}(&self->{v});")
        joined = "\n".join(members)
        self.output.append(f"typedef struct {{\n{joined}\n}} {name}_t;")
        lines = "\n".join(["(void)self;", *begun])
        self.output.append(f"static void begin_{name}({name}_t *self) {{\n{lines}\n}}")
        self.output.append(f"static void {name}({name}_t *self) {{\n{statements}\ndone: ;\n}}")

    def function(self, unit, statements, result):
        inputs, own = [], []
        for one in unit.variables.values():
            v, kind = f"v_{one.name.lower()}", C_TYPES[one.type]
            size = f"[{one.size}]" if one.size else ""
            if one.section == "input":
                inputs.append(f"{kind} {v}")
            elif one.section == "constant":
                values = ", ".join(one.initial)
                self.output.append(
                    f"static const {kind} {unit.name.lower()}_{v}{size} = {{{values}}};"
                )
            else:
                own.append(f"{kind} {v}{size} = {{0}};" if size else f"{kind} {v} = 0;")
        self.output.append(
            f"static {C_TYPES[result]} {unit.name.lower()}({', '.join(inputs)}) {{\n"
            + "\n".join(own)
            + f"\n{statements}\ndone: return v_{unit.name.lower()};\n}}"
        )


HEAD = """#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
static inline int within(int at, int size, int line)
{ if (at < 0 || at >= size) { fprintf(stderr, "line %d: %d of %d\\n", line, at, size); abort(); }
  return at; }
"""
#: Like a task of a control: the same program again and again, as its memory was left.
MAIN = """
static prg_{name}_selftest_t all;
int main(void)
{{
    clock_t begun = clock();
    long cycles = 0;
    begin_prg_{name}_selftest(&all);
    while (!all.v_finished) {{ prg_{name}_selftest(&all); cycles++; }}
    printf("samples %d\\nlargest displacement %.17g\\nlargest difference %.17g\\n", all.v_sample,
        all.v_largest, all.v_worst);
    printf("differing %d\\nagrees %d\\n", all.v_differing, all.v_agrees);
    printf("sample %g\\n", (double)(clock() - begun) / CLOCKS_PER_SEC / (double)cycles);
    return !all.v_agrees;
}}
"""
FLAGS = ["-std=gnu11", "-O0", "-w", "-ffp-contract=off", "-fno-sanitize-recover=all"]
FLAGS += ["-fsanitize=signed-integer-overflow,float-cast-overflow"]


def in_c(*texts):
    """The texts, in this order, as C."""
    return HEAD + Translator().program(parsed("\n".join(texts)))


def run(files, name, folder, flags=FLAGS):
    """Run the self-test of a program, which passes; gives its figures."""
    text = in_c(files[f"{name}.st"], files[f"{name}_selftest.st"]) + MAIN.format(name=name.lower())
    folder.mkdir(exist_ok=True)
    (folder / "st.c").write_text(text, encoding="utf-8")
    command = ["gcc", *flags, "st.c", "-lm", "-o", "st"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    done = subprocess.run(["./st"], cwd=folder, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = re.findall(r"^([a-z ]+?) (-?[\d.e+-]+)$", done.stdout, re.M)
    return {key: float(value) for key, value in figures}


def called(program, folder, calls, more=()):
    """Outputs of a function block in calls of it: inputs beyond the recorded sample by name."""
    name, outputs = program.name.lower(), [one.name for one in program.interface.outputs]
    names = ["status", *more, *outputs]
    lines = []
    for row, call in zip(program.kept.samples.tolist(), calls, strict=False):
        names_in = [f"reading_{one.name}" for one in program.interface.inputs]
        given = {"reset": 0} | dict(zip(names_in, row[1:], strict=True))
        # An input that is not given keeps what it had.
        given |= {"interval": row[0]} if program.interface.timed else {}
        given |= call
        lines += [f"one.v_{key.lower()} = {value};" for key, value in given.items()]
        lines.append(f"fb_{name}(&one);")
        lines += [f'printf("%.17g ", (double)one.v_{key.lower()});' for key in names]
        lines.append('puts("");')
    body = "\n".join(lines)
    text = in_c(st_files(program)[f"{program.name}.st"])
    text += f"\nstatic fb_{name}_t one;\nint main(void) {{ begin_fb_{name}(&one);\n{body} }}\n"
    (folder / "calls.c").write_text(text, encoding="utf-8")
    command = ["gcc", *FLAGS, "calls.c", "-lm", "-o", "calls"]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run(["./calls"], cwd=folder, check=True, capture_output=True, text=True)
    rows = [line.split() for line in done.stdout.splitlines()]
    return [
        {key: int(value) if key in ("status", *more) else float(value) for key, value in pairs}
        for pairs in (zip(names, row, strict=True) for row in rows)
    ]
