"""What all rooms need while they run: errors, notes, budget of memory, tables of parts, jobs, compiled kernel."""

from dynident.runtime.cache import KeepsFacts
from dynident.runtime.errors import (
    GIGABYTE,
    MEMORY_VARIABLE,
    BudgetedFunction,
    ConfigError,
    DynidentError,
    InputError,
    MissingInputError,
    ModelError,
    Noun,
    Step,
    brief,
    budget_scope,
    call_part,
    choices,
    format_bytes,
    install_command,
    join_names,
    memory_budget,
    progress_to,
    report_progress,
    set_budget,
    settings_repr,
    shorten_names,
)
from dynident.runtime.families import check_settings
from dynident.runtime.notes import (
    ConfigRemark,
    Finding,
    Messages,
    Note,
    Remark,
    Severity,
    Statement,
    Use,
    WordedEnum,
    place_and_text,
    require,
)
from dynident.runtime.saved_fields import OMITTED, Axes, Part, TaggedUnion, saved_fields
from dynident.runtime.text import (
    angles,
    as_number,
    capitalise,
    count,
    instant,
    number,
    number_within,
    part_text,
    percent,
    rough,
    setting_text,
    settings_text,
    short,
    vector,
)
