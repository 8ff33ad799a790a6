// Sets the theme that the person chose before the first paint; without a choice the system's one holds.
const chosen = localStorage.getItem("theme");
if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
