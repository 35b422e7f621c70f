/* Names for screen readers where the theme gives none, or one that differs from what is shown. */
addEventListener("load", () => {
  const all = (selector, change) => document.querySelectorAll(selector).forEach(change);
  all(".toctree-toggle", (toggle) => {
    const part = toggle.closest("li").querySelector("a").textContent.trim();
    toggle.parentElement.setAttribute("aria-label", `Pages of ${part}`);
  });
  all(".search-button-field, details.hide > summary", (named) => named.removeAttribute("aria-label"));
  all(".theme-switch-button", (button) =>
    button.setAttribute("aria-label", "Color mode: Light, Dark, System Settings"));
  all("[role=doc-biblioentry]", (entry) => entry.removeAttribute("role"));
  all(".citation-list[role=list]", (list) => list.removeAttribute("role"));
});
