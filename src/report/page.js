const tabs = document.querySelectorAll('[role="tab"]');
for (const tab of tabs) {
  tab.addEventListener("click", () => {
    for (const other of tabs) other.setAttribute("aria-selected", other === tab);
    for (const panel of document.querySelectorAll(".panel")) {
      panel.hidden = panel.dataset.panel !== tab.dataset.panel;
    }
  });
}
