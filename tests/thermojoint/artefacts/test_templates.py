"""The one environment of templates: what is escaped, and what is an error."""

import pytest
from jinja2 import UndefinedError

from thermojoint.artefacts.templates import templates_of


@pytest.mark.parametrize(
    "package",
    [
        "estimator.export",
        "thermojoint.compensation.loop",
        "thermojoint.live.dashboard",
        "thermojoint.paper",
        "thermojoint.standards.iso230_3",
    ],
)
def test_values_are_escaped_in_pages_and_not_in_programs(package):
    environment = templates_of(package)
    for name in environment.list_templates():
        assert environment.autoescape(name) == name.removesuffix(".j2").endswith(".html")


def test_a_name_that_nobody_gives_is_an_error():
    page = templates_of("thermojoint.paper").from_string("{{ nobody }} <{{ mark }}>")
    with pytest.raises(UndefinedError):
        page.render()
    assert "<&lt;>" in templates_of("thermojoint.paper").from_string("<{{ mark }}>").render(
        mark="<"
    )
