"""Pictures, by subject; `jaxurban.plot` names those that users call."""
