"""Pure jitted array functions: no city, projection, file or plot is known here."""

if __name__ != "jaxurban.kernels":
    raise ImportError("import this package as jaxurban.kernels, so that no module is loaded twice")
