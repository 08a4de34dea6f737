// Pages that explain come before attributes of classes that have the word in their name, and before decisions.
var Scorer = {
  score: ([page, , , , score]) => score - (page.startsWith("decisions/") ? 4 : 0),
  objNameMatch: 4,
  objPartialMatch: 1,
  objPrio: { 0: 0, 1: -2, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
