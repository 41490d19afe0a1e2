"""Words that no variable may be called."""

RESERVED = frozenset(  # of C and of IEC 61131-3
    (
        "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else",
        "enum", "extern", "float", "for", "goto", "if", "inline", "int", "long", "register",
        "restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch",
        "typedef", "union", "unsigned", "void", "volatile", "while", "bool", "true", "false",
        "and", "or", "not", "xor", "mod", "by", "to", "of", "at", "on", "time", "exit", "repeat",
        "until", "then", "elsif", "end", "var", "with", "array", "string", "real", "lreal",
        "dint", "lint", "type", "step", "action", "transition", "task", "program", "function",
        "configuration", "resource", "retain", "constant", "abs", "sqrt", "ln", "log", "exp",
        "sin", "cos", "tan", "asin", "acos", "atan", "add", "mul", "sub", "div", "move", "gt",
        "ge", "eq", "le", "lt", "ne", "min", "max", "limit", "sel", "mux", "trunc", "floor",
        "date", "word", "byte", "read_only", "state", "reference", "pointer", "interface",
        "method", "property", "this", "super", "extends", "implements", "abstract", "final",
        "public", "private", "protected", "override", "persistent", "in", "out", "size", "name",
    )
)  # fmt: skip
