"""Public names that are on no API page, by package, and why: Piaffe's other packages need them, users do not."""

FACES = {
    "ocp": "ocp",
    "models": "models",
    "solvers": "solvers",
    "simulation": "src/piaffe/simulation",
    "sampling": "sampling",
    "viz": "src/piaffe/viz",
    "codegen": "src/piaffe/codegen",
}
"""Package → folder of its front page, from the checkout's root."""

_TYPE = "a type of arguments; signatures show what it stands for"
_CHECK = "checks what a user gave, and says so in an error"
_COMMAND = "a step of a command, which calls it"

INTERNAL: dict[str, dict[str, str]] = {
    "ocp": {
        "Kind": _TYPE,
        "PlanarFrame": _TYPE,
        "SolutionLike": _TYPE,
        "TIME_STEP": "the key of the time step in a parameter vector, for low-level controllers",
        "SAME_TIME": "how close two times are that count as one",
        "Sample": _TYPE,
        "When": _TYPE,
        "call": "runs a user's function, and names it in errors",
        "problem_names": "finds problems in a file, for the error that lists them",
        "check_fits": _CHECK,
        "check_numbers": _CHECK,
        "column": "turns what a user's function returned into one column",
        "file_error": "the error of a file that does not run",
        "find_parameter": "finds the parameter of a CasADi symbol, for solvers",
        "initial_state": _CHECK,
        "instance": "a compiled problem with other numbers; solve_batch calls it for each instance",
        "is_same_time": "whether two times count as one",
        "load_problem_file": "a problem with the file it is from; load_problem is the way to a problem",
        "model_of": "the model of a segment, for those who walk a schedule",
        "numbers_of": _CHECK,
        "owner_of": "names the term of a row, for errors of solvers",
        "run_file": "runs a problem's file; load_problem is the way to a problem",
        "split_spec": "splits FILE[:name]; load_problem is the way to a problem",
        "whole_steps": _CHECK,
    },
    "models": {
        "import_mujoco": "imports MuJoCo when it is needed",
        "recursions": "a module; its class Recursion is shown",
        "tree": "a module; its classes are shown",
    },
    "solvers": {},
    "simulation": {
        "Control": _TYPE,
        "MAX_SPEED": "the speed at which a simulation has diverged, for engines",
        "Policy": "of piaffe.ocp, where it is shown",
        "Progress": _TYPE,
        "interpolate": "of piaffe.ocp, where it is shown",
        "node_before": "of piaffe.ocp, where it is shown",
        "phase_index": "of piaffe.ocp, where it is shown",
    },
    "sampling": {
        "Episode": "of piaffe.simulation, where it is shown",
        "Spread": "of piaffe.simulation, where it is shown",
        "listed": _COMMAND,
        "require_executor": _CHECK,
        "require_pyarrow": _CHECK,
        "run_episode": "of piaffe.simulation, where it is shown",
        "text_of": "how a figure writes a setting",
        "try_controllers": _COMMAND,
        "varied": "which settings a figure's legend names",
    },
    "viz": {
        "is_sheet": _CHECK,
        "picture_size": _CHECK,
        "require_picture": _CHECK,
    },
    "codegen": {
        "LazySources": "sources that are made only if the cache lacks them",
        "SOLVER_FLAGS": "compiler flags of the solver",
        "Worker": "a thread that engines and evaluators share work with",
        "c_library": "a small library that a module of Piaffe compiles for itself",
        "fault_of": "why a cached library is not used here, for `piaffe cache`",
        "run_in_parallel": "runs parts of a small library on threads",
        "pointer": "the address of an array, for calls of C",
        "simd": "the module of the generator; generate is shown",
        "this_cpu": "the processor that a library is compiled for",
    },
}
