// Sorting and filtering of the table of files. Without this script the page shows everything, by name.
(() => {
  'use strict';
  const table = document.getElementById('files');
  if (!table) return;
  const body = table.tBodies[0];
  const rows = Array.from(body.rows);
  const heads = Array.from(table.tHead.rows[0].cells);
  const said = document.getElementById('shown');

  // Cards on a phone take their layout from `display`, which would take the table's meaning from them.
  table.setAttribute('role', 'table');
  table.tHead.setAttribute('role', 'rowgroup');
  table.tHead.rows[0].setAttribute('role', 'row');
  heads.forEach((head) => head.setAttribute('role', 'columnheader'));
  body.setAttribute('role', 'rowgroup');
  for (const row of rows) {
    row.setAttribute('role', 'row');
    for (const cell of row.cells) cell.setAttribute('role', cell.tagName === 'TH' ? 'rowheader' : 'cell');
  }

  // Each row's value in a column: a number, a text, or null where there is none.
  const value = (row, column, numeric) => {
    const cell = row.cells[column];
    if (numeric) return cell.dataset.v === undefined ? null : Number(cell.dataset.v);
    return (cell.dataset.v ?? cell.textContent).toLowerCase() || null;
  };
  const compare = (a, b) => (a < b ? -1 : a > b ? 1 : 0);

  const sort = (column, direction) => {
    const numeric = heads[column].classList.contains('n');
    const sign = direction === 'ascending' ? 1 : -1;
    // Rows without a value come last whichever way; equal ones keep the order of names.
    const keyed = rows.map((row, index) => ({ row, index, key: value(row, column, numeric) }));
    keyed.sort((a, b) => {
      if (a.key === null || b.key === null) return (a.key === null) - (b.key === null) || a.index - b.index;
      return sign * compare(a.key, b.key) || a.index - b.index;
    });
    body.append(...keyed.map((entry) => entry.row));
    heads.forEach((head, i) => {
      if (i === column) head.setAttribute('aria-sort', direction);
      else head.removeAttribute('aria-sort');
    });
  };

  heads.forEach((head, column) => {
    const button = head.querySelector('button');
    if (!button) return;
    button.addEventListener('click', () => {
      // Of figures the largest are looked for, of names the first.
      const first = head.classList.contains('n') ? 'descending' : 'ascending';
      const other = first === 'ascending' ? 'descending' : 'ascending';
      sort(column, head.getAttribute('aria-sort') === first ? other : first);
    });
  });

  const status = document.getElementById('status');
  const search = document.getElementById('search');
  const filter = () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    for (const row of rows) {
      const text = row.cells[0].textContent.toLowerCase() + ' ' + row.cells[2].textContent;
      const shown = (!status.value || row.dataset.s === status.value) && words.every((word) => text.includes(word));
      row.hidden = !shown;
      count += shown;
    }
    said.value = count === rows.length ? `${rows.length} files` : `${count} of ${rows.length} files`;
  };
  status.addEventListener('change', filter);
  search.addEventListener('input', filter);
  filter();
})();
