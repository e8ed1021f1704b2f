"use strict";
// A click on a heading sorts its table by that column; another one turns the order round. Empty entries stay last.
for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => {
    const head = button.closest("th"), table = head.closest("table"), body = table.tBodies[0];
    const column = head.cellIndex, up = head.getAttribute("aria-sort") !== "ascending";
    const number = head.classList.contains("number");
    const key = (row) => {
      const value = row.cells[column].dataset.value ?? row.cells[column].textContent;
      return number ? parseFloat(value) : value;
    };
    const compare = (a, b) => {
      const [x, y] = [key(a), key(b)];
      if (number && (isNaN(x) || isNaN(y))) return isNaN(x) - isNaN(y);
      return (up ? 1 : -1) * (number ? x - y : x.localeCompare(y));
    };
    body.append(...[...body.rows].sort(compare));
    for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
  });
}
