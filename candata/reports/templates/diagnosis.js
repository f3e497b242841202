(() => {
  const rows = document.querySelectorAll("tr.pick"), panels = document.querySelectorAll(".panel");
  const show = (label, move) => {
    panels.forEach(p => { p.hidden = p.dataset.element !== label; });
    rows.forEach(r => { const on = r.dataset.shows === label; r.classList.toggle("on", on);
      r.querySelector("button").setAttribute("aria-pressed", on); });
    const open = document.querySelector(".panel:not([hidden])");
    if (move && open && !matchMedia("(min-width:1001px)").matches)
      open.scrollIntoView({ behavior: "smooth", block: "nearest" });
  };
  rows.forEach(r => r.addEventListener("click", () => show(r.dataset.shows, true)));
  const open = document.querySelector(".panel:not([hidden])");
  if (open) show(open.dataset.element, false);
  const button = document.getElementById("copy");
  const file = document.getElementById("effects-file");
  if (button) button.addEventListener("click", async () => {
    try { await navigator.clipboard.writeText(file.textContent); button.textContent = "Copied"; }
    catch { getSelection().selectAllChildren(file); button.textContent = "Selected: press Ctrl+C"; }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  });
})();
