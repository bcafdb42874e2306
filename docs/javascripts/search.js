/* Search takes a word that begins with "-" for one to leave out: an option is searched for without its dashes. */
document.addEventListener("input", ({ target }) => {
  if (!target.matches("input.md-search__input")) return;
  target.value = target.value.replace(/(^|\s)-+(?=\w)/g, "$1");
}, true);
