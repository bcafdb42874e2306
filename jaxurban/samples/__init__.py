"""Three real cities in the package, their licences in NOTICE.md, and a synthetic one."""
