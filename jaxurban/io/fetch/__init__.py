"""What `jaxurban fetch` does: plan, download, validate, and stage the files of a region."""
