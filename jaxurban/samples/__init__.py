"""Three real cities in the package, their licences in NOTICE.md, and the script that makes them."""
