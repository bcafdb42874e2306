"""Path planners on plain arrays."""

if __name__ != "jaxurban.planners":
    raise ImportError("import this package as jaxurban.planners, so that no module is loaded twice")
