"""Stand-in for generate_parameter_library: writes its header from the same YAML.

    python parameters.py identified_arm_parameters.yaml HEADER

Types and validators are those that the file uses; another one is an error.
"""

import sys
from pathlib import Path

import yaml

TYPES = {
    "bool": "bool",
    "double": "double",
    "string": "std::string",
    "string_array": "std::vector<std::string>",
    "double_array": "std::vector<double>",
}
CHECKS = {  # validator: C++ condition of the value x
    "gt<>": "x > {0}",
    "gt_eq<>": "x >= {0}",
    "lt_eq<>": "x <= {0}",
    "not_empty<>": "!x.empty()",
    "unique<>": "std::set<std::string>(x.begin(), x.end()).size() == x.size()",
    "one_of<>": "std::set<std::string>{0}.count(x) == 1",
    "lower_element_bounds<>": "x.empty() || *std::min_element(x.begin(), x.end()) >= {0}",
}
HEAD = """// Made by stub/parameters.py in place of generate_parameter_library.
#pragma once

#include <algorithm>
#include <memory>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "rclcpp/rclcpp.hpp"

"""
LISTENER = """
class ParamListener
{{
public:
  explicit ParamListener(const std::shared_ptr<rclcpp_lifecycle::LifecycleNode> & node)
  {{
    std::size_t used = 0;
{reads}
    if (used != node->overrides.size()) throw std::invalid_argument("unknown parameter");
  }}
  Params get_params() const {{ return params_; }}

private:
  Params params_;
}};
"""
READ = """    {{
      auto & x = params_.{name};
      const auto given = node->overrides.find("{name}");
      if (given != node->overrides.end()) {{
        const auto * value = std::get_if<{type}>(&given->second);
        if (value == nullptr) throw std::invalid_argument("parameter {name}: wrong type");
        x = *value;
        used++;
      }}
{checks}
    }}"""


def literal(value):
    """Return a value as C++."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return "{" + ", ".join(map(literal, value)) + "}"
    return repr(float(value))


def parameters(node, prefix=""):
    """Yield name and definition of every parameter."""
    for name, content in node.items():
        if "type" in content:
            yield prefix + name, content
        else:
            yield from parameters(content, f"{prefix}{name}.")


def structure(node, indent="  "):
    """Return the members of the struct of parameters."""
    lines = []
    for name, content in node.items():
        if "type" in content:
            default = literal(content["default_value"])
            lines.append(f"{indent}{TYPES[content['type']]} {name} = {default};")
        else:
            lines += [f"{indent}struct", f"{indent}{{", *structure(content, indent + "  ")]
            lines.append(f"{indent}}} {name};")
    return lines


def read(name, content):
    """Return the C++ that reads and checks a parameter."""
    checks = []
    for validator, arguments in (content.get("validation") or {}).items():
        condition = CHECKS[validator].format(*map(literal, arguments or ()))
        message = f"parameter {name}: {validator} {arguments or ''}".strip().replace('"', "'")
        checks.append(f'      if (!({condition})) throw std::invalid_argument("{message}");')
    return READ.format(name=name, type=TYPES[content["type"]], checks="\n".join(checks))


def main(source, target):
    """Write the header."""
    ((namespace, tree),) = yaml.safe_load(Path(source).read_text()).items()
    reads = "\n".join(read(*each) for each in parameters(tree))
    body = ["struct Params", "{", *structure(tree), "};", LISTENER.format(reads=reads)]
    text = HEAD + f"namespace {namespace}\n{{\n\n" + "\n".join(body) + "\n}\n"
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    Path(target).write_text(text)


if __name__ == "__main__":
    main(*sys.argv[1:])
